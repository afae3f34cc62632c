"""The planted effects, for evaluating what was found. Only tests and their judges may read it."""

from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import msgspec

from ingest.simulator.physics.draws import SampleRange
from ingest.simulator.physics.gyro import SimulatedGyro
from ingest.simulator.physics.imu import AXES, SimulatedImu
from ingest.simulator.physics.plan import Plan
from stream.errors import BadInput
from stream.files.atomic_file import replacement


def truth(gyro: SimulatedGyro, duration_s: float) -> dict[str, Any]:
    """Everything that is planted in one power-on and drawn for it over its first `duration_s` seconds.

    ``parameters`` are as drawn for the unit, noise by its coefficients; ``drawn`` is by power-on and day; ``jumps`` are
    pairs of seconds from power-on and deg/h, planned ones too; ``dropouts`` and ``stuck`` are pairs of the first sample
    and the one after the last.

    >>> from ingest.simulator.physics.bias import Bias, BiasStep
    >>> from ingest.simulator.physics.gyro import GyroParameters
    >>> parameters = GyroParameters(bias=Bias(step=(BiasStep(at_s=5.0, size_deg_per_h=2.0),)))
    >>> truth(SimulatedGyro(parameters, seed=1, unit="FOG-1"), 60.0)["jumps"]
    [(5.0, 2.0)]
    """
    samples = -(-round(duration_s * 1e9) // gyro.parameters.sample_interval_ns)
    bias, readout = gyro.bias_effect, gyro.readout_effect
    drawn = {
        "bias_turn_on_deg_per_h": bias.turn_on_deg_per_h if bias else 0.0,
        "bias_day_deg_per_h": bias.day_deg_per_h if bias else 0.0,
        "scale_turn_on_ppm": gyro.scale_effect.turn_on_ppm, "scale_day_ppm": gyro.scale_effect.day_ppm,
    }  # fmt: skip
    return {
        "unit": gyro.unit, "power_on": gyro.power_on, "day": gyro.day, "age_h": gyro.age_h, "seed": gyro.seed,
        "duration_s": duration_s, "parameters": msgspec.to_builtins(gyro.parameters), "drawn": drawn,
        "jumps": [tuple(jump) for jump in bias.jumps_until(duration_s)] if bias else [],
        "dropouts": _within(readout.dropouts(), samples), "stuck": _within(readout.stuck(), samples),
    }  # fmt: skip


def imu_truth(imu: SimulatedImu, duration_s: float) -> dict[str, Any]:
    """The same of an inertial measurement unit: ``gyros`` and ``accelerometers`` by axis."""
    return {
        "unit": imu.unit, "power_on": imu.power_on, "seed": imu.seed, "duration_s": duration_s,
        "gyros": {axis: truth(gyro, duration_s) for axis, gyro in zip(AXES, imu.gyros, strict=True)},
        "accelerometers": {
            axis: {"parameters": msgspec.to_builtins(each.parameters), "bias_turn_on_ug": each.bias_turn_on_ug}
            for axis, each in zip(AXES, imu.accelerometers, strict=True)
        },
    }  # fmt: skip


def write_truth(path: Path, plan: Plan, *, power_ons: int, duration_s: float) -> None:
    """Write the truth of the first power-ons of every unit, a line of JSON each; raises BadInput if it cannot."""
    if not 0.0 <= duration_s < float("inf"):
        raise BadInput(f"truth {path}: a duration of {duration_s} s, a finite number from 0 on is needed")
    gyros = (plan.gyro(unit, power_on) for unit in plan.units for power_on in range(1, power_ons + 1))
    try:
        with replacement(path) as fresh, fresh.open("wb") as file:
            file.writelines(msgspec.json.encode(truth(gyro, duration_s)) + b"\n" for gyro in gyros)
    except OSError as error:
        raise BadInput(f"truth {path}: cannot be written ({error.strerror or error})") from error


def _within(ranges: Iterator[SampleRange], samples: int) -> list[tuple[int, int]]:
    """Those that begin within the samples, cut at their end."""
    begun = takewhile(lambda each: each.first < samples, ranges)
    return [(each.first, min(each.stop, samples)) for each in begun]
