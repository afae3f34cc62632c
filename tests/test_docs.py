"""The documentation: links lead somewhere, files and commands that it names exist, and the README stays short."""

import re
from pathlib import Path

import click
import pytest

from docs import file_keys
from gyrofleet import main
from tests.sources import SOURCES

ROOT = Path(__file__).parents[1]
DOCS = [
    page for page in (ROOT / "docs").rglob("*.md") if not {"_build", "_generated"} & set(page.relative_to(ROOT).parts)
]
PAGES = (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS))
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
TOCTREE = re.compile(r"```\{toctree\}\n(.*?)```", re.DOTALL)
NAMED_FILE = re.compile(r"`((?:tests|stream|storage|ingest|analytics)/[\w/.-]+\.(?:py|toml|sql|proto))`")
COMMAND = re.compile(r"(?m)^\s*gyrofleet[ ]+([a-z-]+)(?:[ ]+([a-z-]+))?")


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_lead_somewhere(page: Path) -> None:
    found = [target for target, _ in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target]
    assert [target for target in found if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES[:1] + PAGES[2:], ids=named)
def test_files_that_are_named_exist(page: Path) -> None:
    found = NAMED_FILE.findall(page.read_text(encoding="utf-8"))
    assert [each for each in found if not any((place / each).exists() for place in (ROOT, SOURCES))] == []


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_commands_that_are_shown_exist(page: Path) -> None:
    shells = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for command, _ in COMMAND.findall("\n".join(shells)):
        assert command in main.list_commands(click.Context(main)), f"gyrofleet {command}"


def test_every_page_is_reached_from_the_readme() -> None:
    reached, waiting = {ROOT / "README.md"}, [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        text = page.read_text(encoding="utf-8")
        listed = [f"{line}.md" for block in TOCTREE.findall(text) for line in block.split() if not line.startswith(":")]
        for target in [*(target for target, _ in LINK.findall(text)), *listed]:
            path = (page.parent / target).resolve()
            if path.suffix == ".md" and path.exists() and path not in reached:
                reached.add(path)
                waiting.append(path)
    assert [named(page) for page in PAGES if page not in reached] == []


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_the_keys_of_a_stations_files_are_those_that_are_read() -> None:
    written = (ROOT / "docs" / "reference" / "station-files.md").read_text(encoding="utf-8")
    assert written == f"{file_keys.page()}\n", (
        "write it again: python -m docs.file_keys > docs/reference/station-files.md"
    )
    for key in ("set_rate", "TEMP:SETP", "room_deg_c", "modulus", "wait_settled", "length_field", "power"):
        assert f"`{key}" in written
