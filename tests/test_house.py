"""The house itself: its packages have one owner each, and nobody else's names are in the way."""

import importlib.metadata
from importlib.resources import files

import pytest

PACKAGES = ("stream", "storage", "ingest", "analytics", "gyrofleet")


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_exactly_one_owner(package: str) -> None:
    owners = set(importlib.metadata.packages_distributions().get(package, ["gyrofleet"]))
    assert owners == {"gyrofleet"}, f"{package} is installed by {owners}; remove the other distribution"


@pytest.mark.parametrize(
    ("package", "name"),
    [
        ("stream.wire", "samples.proto"),
        ("stream", "py.typed"),
        ("storage.sql", "schema/10_tables.sql"),
        ("storage.sql", "schema/20_views.sql"),
        ("analytics.demo", "demo_limits.toml"),
        ("analytics.loop.report", "templates/diagnosis.html.jinja"),
        ("ingest.simulator", "station_template/station.toml"),
    ],
)
def test_what_is_not_python_is_shipped_too(package: str, name: str) -> None:
    assert files(package).joinpath(name).is_file()
