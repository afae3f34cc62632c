"""What a file states of the station of its runs, beside what is stored of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ingest.importing.shared_runs import OtherTests
from ingest.measurement_standards import DETAIL
from stream.errors import BadInput


@dataclass(frozen=True)
class Restated:
    """A stored run whose station a file states: its units, and each detail that changes with its values before and now.

    `changes` has null for what was not stated before. All values of these units in the run rest on them.
    """

    run: str
    units: tuple[str, ...]
    changes: Mapping[str, tuple[str | None, str]]

    def __str__(self) -> str:
        listed = ", ".join(
            "measurement standards" if name == DETAIL else f"{name} {old or '(not stated)'} -> {new}"
            for name, (old, new) in self.changes.items()
        )
        units = f"unit{'' if len(self.units) == 1 else 's'} {', '.join(self.units)}"
        return f"the values of {units}, run {self.run} rest on what is stated now: {listed}"


def restated(run: str, units: Sequence[str], stored: Mapping[str, str], about: Mapping[str, str]) -> Restated:
    """How the statement of a file changes that of a stored run."""
    changes = {name: (stored.get(name), value) for name, value in about.items() if stored.get(name) != value}
    return Restated(run, tuple(units), changes)


def check_details(
    path: Path, run: str, stored: Mapping[str, str], about: Mapping[str, str], others: OtherTests
) -> None:
    """Refuse details of a station that differ from the stored ones: values would change silently."""
    for name, value in about.items():
        if stored.get(name, value) == value:
            continue
        differs = f"{name} {stored[name]}, now it is {value}"
        if name == DETAIL:
            differs = "other measurement standards than the station's file states now"
        stays = f"{path}: run {run} is stored with {differs}; what is stored stays."
        remedy, too = "To correct it, and all values that rest on it,", ""
        if others.spans:
            text = others.text(stored.get("time_zone"))
            remedy = f"The run has {text}: import another test as a run of its own, --run NAME. To correct the run,"
            too = f", which changes the values of {text} as well"
        raise BadInput(f"{stays} {remedy} give --restate{too}")
