"""Who did it is whom a certificate proves, with and without a recorder at work; a name that is typed is only that."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.sql.catalog import Catalog
from storage.store import Store, writer_endpoint
from tests.secured_sites import make_site

CHECK = ("check", "--store", "S", "--unit", "U1", "--item", "visual", "--verdict", "pass")
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
upper = 1.0
unit_of_measure = "deg/h"
"""


def documents(folder: Path) -> list[dict[str, Any]]:
    sql = "select document from events where kind <> 'StoreNoted' order by t_ns"
    with Catalog(Store.open(folder / "S")) as catalog:
        return [json.loads(text) for (text,) in catalog.rows(sql)]


@pytest.mark.long
@pytest.mark.parametrize("is_recorded", [False, True], ids=["no_recorder", "recorder"])
def test_an_act_is_of_whom_the_certificate_names(
    is_recorded: bool, tmp_path: Path, gyrofleet: Callable[..., Any], spawn: Callable[..., subprocess.Popen[str]],
    endpoint: str,
) -> None:  # fmt: skip
    make_site(tmp_path / "site")
    (tmp_path / "fog.toml").write_text(LIMITS)
    if is_recorded:
        recorder = spawn("record", "--store", "S", "--listen", endpoint, "--security", "site/recorder/recorder")
        until = time.monotonic() + 30.0
        while writer_endpoint(tmp_path / "S") is None and time.monotonic() < until:
            time.sleep(0.05)
    lead = ("--security", "site/approver/lead")
    done = gyrofleet(*CHECK, *lead)
    assert done.code == 0, done.err
    for other in ("Wu", "approver:chief"):
        refused = gyrofleet(*CHECK, *lead, "--by", other)
        assert refused.code == 1
        assert f"--by '{other}' names somebody else than the certificate, which is of approver lead" in refused.err
    entered = gyrofleet("limits", "add", "fog.toml", "--store", "S", "--by", "Lead", *lead)
    assert entered.code == 0, entered.err
    station = gyrofleet("limits", "withdraw", "fog-A", "--store", "S", "--reason", "x", "--security", "site/station/c1")
    assert station.code == 1
    assert "needs a certificate of role approver or recorder" in station.err
    typed = gyrofleet(*CHECK, "--by", "approver:lead")
    assert typed.code == 0, typed.err
    nobody = gyrofleet(*CHECK)
    assert nobody.code == 1
    assert "--by is missing" in nobody.err
    if is_recorded:
        recorder.terminate()
        assert recorder.wait(timeout=60) == 0
    assert [(each["kind"], each["by"], each["identity"]) for each in documents(tmp_path)] == [
        ("CheckEntered", "approver:lead", "approver:lead"),
        ("SpecificationEntered", "approver:lead", "approver:lead"),
        ("CheckEntered", "approver:lead", "unauthenticated"),
    ]
    audited = ("audit", "--unit", "U1", "--store", "S")
    rows = gyrofleet(*audited, "--json").json
    proved = [each["identity"] for each in rows if each["kind"] == "CheckEntered"]
    assert proved == ["approver:lead", "unauthenticated"]
    first, second = [line for line in gyrofleet(*audited).out.splitlines() if "visual" in line]
    assert first.count("approver:lead") == 2  # who, and proved
    assert second.count("approver:lead") == 1
    assert " no " in second
