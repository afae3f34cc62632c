"""What `gyrofleet import` warns of: words that no procedure has, standards that were out of date."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stream.mistakes import near_name
from stream.terminal.console import notes

if TYPE_CHECKING:
    from ingest.tables.sample_file import TableSummary

_IRA_WORDS = tuple(f"IRA_{each}" for each in ("up", "east", "north", "down", "west", "south", "east_west"))


def warn_of_overdue(station: str | None, summaries: "Sequence[TableSummary]") -> None:
    """Warn of standards of the station that were due before the files were recorded: what they state is unknown."""
    began = [each.signals[0].sampling.t_first_ns for each in summaries if each.date_known and each.signals]
    if station is None or Path(station).suffix.lower() != ".toml" or not began:
        return
    from ingest.station.station import load_station

    found = load_station(Path(station))
    days = [found.day(each) for each in began]
    for each in dict.fromkeys(each for day in days for each in found.overdue(day, day)):
        notes().print(f"warning: {each}: what it states counts as unknown", soft_wrap=True)


def warn_of_words(procedure: str | None, position: str | None) -> None:
    """Warn of a procedure or position that no characteristic uses: perhaps a typing error."""
    if not procedure and not position:
        return
    from ingest.procedures.file import ready_names, ready_text
    from ingest.procedures.procedure import load_procedure

    if procedure and procedure not in ready_names():
        near = near_name(procedure, ready_names()) or ":"
        notes().print(
            f"warning: --procedure {procedure} is none of gyrofleet's, which `gyrofleet procedure list` has{near} "
            f"the step is judged by its position alone",
            soft_wrap=True,
        )
    if position and position not in _IRA_WORDS:
        known = set(_IRA_WORDS)
        # one that has the word in its text comes first: planning the steps of all takes longer than a small import
        for name in sorted(ready_names(), key=lambda name: position not in ready_text(name)):
            known.update(each for step in load_procedure(name).steps() if (each := step.words.position))
            if position in known:
                return
        notes().print(
            f"warning: --position {position} is none of IRA_up, IRA_east, IRA_north, Z_up, X_east_Y_north and their "
            f"like{near_name(position, sorted(known)) or ':'} nothing says how the input axis lies",
            soft_wrap=True,
        )
