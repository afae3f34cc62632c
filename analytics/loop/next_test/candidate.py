"""Candidate test: a procedure that may decide between rival effects."""

from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from ingest.procedures.file import ProcedureFile
from ingest.procedures.plan import PlannedStep, Planner, Used
from stream.decoding import converted
from stream.errors import BadInput


class CandidateTest(msgspec.Struct, frozen=True, kw_only=True):
    """A test: its name, what is done, and its steps as in the file of a procedure.

    Parameters
    ----------
    volts: Supply that the operator sets for each step; empty if it stays.
    repeats: Runs of it, each with a power-on of its own.
    like: The run that it repeats; it then has no steps of its own.
    """

    name: str
    what: Bilingual
    steps: tuple[dict[str, Any], ...] = ()
    volts: tuple[float, ...] = ()
    repeats: int = 1
    like: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """The procedure as in its file."""
        return {
            "name": self.name,
            "names": {"en": str(self.what), "zh": self.what.zh},
            "source": ["gyrofleet diagnose --next-test"],
            "step": list(self.steps),
        }

    def planned(self) -> tuple[PlannedStep, ...]:
        """Its steps as `gyrofleet run` executes them; BadInput if they are none that it can."""
        try:
            file = converted(self.document, ProcedureFile)
        except msgspec.ValidationError as error:
            raise BadInput(f"test {self.name}: {error}") from error
        return Planner(self.name).plan(Used(file.items, self.name, {}), {})


def loop(setting: str, values: Iterable[float], record_s: float) -> dict[str, Any]:
    """A loop over the values of a setting, each recorded for a time."""
    name = setting.partition("_")[0]
    return {
        "for": name,
        "values": [float(np.round(each, 4)) for each in values],
        setting: f"${name}",
        "step": [{"name": name, "record_s": float(np.round(record_s, 1))}],
    }


def mounting(position: str) -> dict[str, Any]:
    """An operator mounts the units; the next step has the position."""
    axis, _, towards = position.partition("_")
    way, way_zh = _WAYS[towards]
    return {
        "name": "mount",
        "prompt": {"en": f"Mount the units with {axis} {way}.", "zh": f"将陀螺仪安装为{axis}{way_zh}。"},
    }


_WAYS = {
    "up": ("up, along the table's axis", "向上，沿转台轴"),
    "down": ("down", "向下"),
    "horizontal": ("horizontal", "水平"),
}
