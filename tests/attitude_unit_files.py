"""Files of an attitude unit as a laboratory has them: what the axes give is written down here from the model of JJF
1536-2015 (3), apart from the code under test."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

EARTH_DEG_PER_H = 15.041067
FOUR = {"east north": 1.0, "east south": 1.0, "west south": -1.0, "west north": -1.0}
SECOND = {"X": "Y", "Y": "Z", "Z": "X"}


class Sheet:
    """A CSV file that is filled step by step: the angle that each axis has turned since the step began, or its rate."""

    def __init__(self, titles: Mapping[str, str], words: Sequence[str], *, dt_s: float = 1.0) -> None:
        self.titles, self.words, self.dt_s = titles, words, dt_s
        self.rows: list[str] = [",".join(["time[s]", *titles.values(), *words])]
        self.t_s = 0.0

    def step(self, samples: Mapping[str, Iterable[float]], **words: Any) -> None:
        """A step with its samples by axis."""
        tail = [str(words.get(word.partition("[")[0], "")) for word in self.words]
        for values in zip(*(samples[axis] for axis in self.titles), strict=True):
            self.rows.append(",".join([f"{self.t_s:.3f}", *(f"{value:.9f}" for value in values), *tail]))
            self.t_s += self.dt_s
        self.t_s += 60.0

    def write(self, path: Path) -> Path:
        path.write_text("\n".join(self.rows) + "\n")
        return path


def ramp(total: float, n: int, start: float = 0.0) -> list[float]:
    """An angle that grows evenly from `start` by `total` in n intervals."""
    return [start + total * i / n for i in range(n + 1)]


def four_positions(
    sheet: Sheet, biases: Mapping[str, float], record_s: Mapping[str, int] | int = 1800, *,
    heading_error_deg: float = 0.0, latitude_deg: float = 39.9, order: Sequence[str] = tuple(FOUR), axes: str = "XYZ",
    procedure: str = "attitude_unit_bias",
) -> None:  # fmt: skip
    """Angles of an axis that is level, in its four positions: N = (B +- Omega_e cos(lat) sin(error)) T."""
    level = EARTH_DEG_PER_H * math.cos(math.radians(latitude_deg)) * math.sin(math.radians(heading_error_deg))
    for axis in axes:
        for place in order:
            towards, over = place.split()
            lasts_s = record_s if isinstance(record_s, int) else record_s[place]
            n = round(lasts_s / sheet.dt_s)
            samples = {
                each: ramp((biases[each] + (FOUR[place] * level if each == axis else 0.0)) * lasts_s / 3600, n)
                for each in sheet.titles
            }
            position = f"{axis}_{towards}_{SECOND[axis]}_{over}"
            sheet.step(samples, procedure=procedure, axis=axis, position=position)


def turns(
    sheet: Sheet, matrix: Mapping[str, float], biases: Mapping[str, float], *, rate: float = 100.0, whole: float = 10.0,
    axes: str = "XYZ",
) -> None:  # fmt: skip
    """Angles of all axes while one turns: N_i = L_ij A_j + B_i T."""
    lasts_s = whole * 360.0 / rate
    n = round(lasts_s / sheet.dt_s)
    for axis in axes:
        for way in (1, -1):
            turned = way * whole * 360.0
            samples = {
                each: ramp((1.0 if each == axis else matrix[each + axis]) * turned + biases[each] * lasts_s / 3600, n)
                for each in sheet.titles
            }
            words = {"axis": axis, "position": f"{axis}_up", "rate_command": way * rate}
            sheet.step(samples, procedure="attitude_unit_misalignment", **words)
