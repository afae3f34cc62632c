"""Rows of the separation metrics: one for each angle, or one that says what is missing."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from analytics.calibration.separation import Separation
from storage.sql.catalog import Catalog
from stream.errors import BadInput

_GROUP = ("run", "unit", "signal", "procedure")
Separate = Callable[[Sequence[Mapping[str, Any]]], Separation]


def separation_rows(
    catalog: Catalog,
    statement: str,
    positions: Mapping[str, Any],
    lack: Callable[[Sequence[Mapping[str, Any]]], str | None],
    separate: Separate,
) -> Iterator[dict[str, Any]]:
    """Rows of a metric.

    Parameters
    ----------
    catalog: Of the store.
    statement: Gives `run, unit, signal, procedure, index, position, scale_source` of each step, and what `lack` and
        `separate` take; in the order of the first four.
    positions: The positions that the method names, by their words.
    lack: What a group's steps lack besides positions, None if nothing.
    separate: Solves a group; what it raises as `BadInput` is the reason why there is no value.
    """
    steps: list[dict[str, Any]] = catalog.reader(statement).read_all().to_pylist()
    for key, group in groupby(steps, lambda row: tuple(row[name] for name in _GROUP)):
        rows = list(group)
        common = dict(zip(_GROUP, key, strict=True)) | {
            "n": len(rows),
            "runs": [key[0]],
            "steps": [row["index"] for row in rows],
        }
        words = {"scale_factor": rows[0]["scale_source"], "steps_at_each": len(rows) // len(positions)}
        missing = [name for name in positions if name not in {row["position"] for row in rows}]
        reason = f"position {', '.join(missing)} was not measured" if missing else lack(rows)
        if reason is None:
            try:
                yield from _angles(separate(rows), common, words)
            except BadInput as error:
                reason = str(error)
        if reason is not None:
            yield common | {"parameters": json.dumps({"angle": "gamma"} | words), "reason": reason}


def _angles(found: Separation, common: Mapping[str, Any], words: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for name, angle in (found.angles | {"gamma": found.gamma}).items():
        yield {
            **common,
            "value": angle.value,
            "lo": angle.lo,
            "hi": angle.hi,
            "standard_uncertainty": angle.standard_error,
            "freedom": float(found.freedom),
            "parameters": json.dumps({"angle": name, **words, "rms": float(f"{found.rms:.4g}")}),
        }
