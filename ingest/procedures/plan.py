"""The steps of a procedure in order, with its loops unrolled."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

import msgspec

from ingest.procedures.file import Item, Names
from ingest.procedures.values import Scalar, Variables, bound_value, check_form, number_of, rounds, text_of
from stream.errors import BadInput
from stream.events import StepWords
from stream.mistakes import near_name

# Settings of instruments, with units of measure.
SETTINGS: Mapping[str, str] = MappingProxyType(
    {"rate": "deg/s", "temperature": "degC", "frequency": "Hz", "amplitude": "deg/s", "angle": "deg"}
)
_FIELDS = {
    "rate_deg_per_s": "rate", "temperature_deg_c": "temperature", "frequency_hz": "frequency",
    "amplitude_deg_per_s": "amplitude", "angle_deg": "angle",
}  # fmt: skip
# Defaults that a loop gives to the steps in it.
_INHERITED = (*_FIELDS, "position", "axis", "phase", "settle_s", "record_s", "warm_up_s", "room", "wait_settled")
_POWER = ("off", "on", "cycle", "none")
# A table either turns or stands at an angle: to command one ends the other.
ENDS = {"rate": "angle", "angle": "rate"}
_MOST_STEPS = 100_000
_LONGEST_S = 366 * 86_400.0

Power: TypeAlias = Literal["off", "on", "cycle"]


class PlannedStep(msgspec.Struct, frozen=True, kw_only=True):
    """One step, in the order in which its parts are done.

    1. `prompt`: an operator does something and confirms.
    2. `power` ``off`` or ``cycle``: the units are switched off, for `off_s`.
    3. `settings` are commanded; then all of `wait_settled` have settled.
    4. `power` ``on`` or ``cycle``: the units are switched on; `warm_up_s` is waited.
    5. If `record_s` is not 0 the step begins in the data (StepStarted with `words`): `settle_s`, which the evaluation
       drops, then `record_s`. Otherwise `settle_s` is only waited, and the step is not in the data.

    Units have power when the first step begins.
    """

    number: int  # place in the procedure, from 1
    words: StepWords  # its description in the data
    settings: dict[str, float] = {}  # new settings of instruments, in the units of `SETTINGS`
    settle_s: float = 0.0
    record_s: float = 0.0
    wait_settled: tuple[str, ...] = ()
    power: Power | None = None
    off_s: float = 0.0
    warm_up_s: float = 0.0
    prompt: Names | None = None
    part: str = ""  # the part of the procedure that it belongs to
    key: str = ""  # its key in the file

    @property
    def is_recorded(self) -> bool:
        """Whether the step leaves data."""
        return self.record_s > 0.0


class Used(msgspec.Struct, frozen=True):
    """The steps of a procedure, its file for messages, and the procedures that it uses."""

    items: tuple[Item, ...]
    source: str
    procedures: Mapping[str, "Used"]


class Planner:
    """Unrolls the steps of a procedure; its name goes into the words of every step."""

    def __init__(self, procedure: str) -> None:
        self._procedure = procedure
        self._state: dict[str, float] = {}
        self._is_powered = True
        self._steps: list[PlannedStep] = []

    def plan(self, used: Used, variables: Variables) -> tuple[PlannedStep, ...]:
        """All steps."""
        for i, item in enumerate(used.items):
            part = item.name or item.use or (f"for {item.over}" if item.over is not None else "repeats")
            self._item(item, used, f"$.step[{i}]", dict(variables), {}, part, frozenset())
        return tuple(self._steps)

    def _item(
        self, item: Item, used: Used, key: str, variables: dict[str, Scalar | tuple[Scalar, ...]],
        inherited: dict[str, object], part: str, loops: frozenset[str],
    ) -> None:  # fmt: skip
        """Plan an item within the `loops` of its own file."""
        where = f"{used.source}: {key}"
        check_form(item, where)
        if item.over in loops:
            raise BadInput(
                f"{where}.for: {item.over!r} is the variable of a loop around this one; give it another name"
            )
        loops = loops | ({item.over} if item.over is not None else frozenset())
        if item.use is None and not item.items:
            self._step(item, where, key, variables, inherited, part)
            return
        for bound in rounds(item, variables, where):
            inner = {**variables, **bound}
            # evaluated here, with the loop's variables and not with those of the procedure that it uses
            down = {**inherited, **_filled(item, inner, where)}
            if "repeat" in bound and item.times is not None:
                down["repeat"] = bound["repeat"]
            if item.use is not None:
                other = used.procedures[item.use]
                for name, value in item.overrides.items():
                    inner[name] = bound_value(value, inner, f"{where}.set.{name}")
                for i, each in enumerate(other.items):
                    self._item(each, other, f"$.step[{i}]", inner, down, part, frozenset())
            for i, each in enumerate(item.items):
                self._item(each, used, f"{key}.step[{i}]", inner, down, part, loops)

    def _step(
        self, item: Item, where: str, key: str, variables: Variables, inherited: dict[str, object], part: str
    ) -> None:
        given = {**inherited, **_filled(item, variables, where)}
        settings = {name: float(given[field]) for field, name in _FIELDS.items() if field in given}  # type: ignore[arg-type]
        names = ("settle_s", "record_s", "warm_up_s")
        times = {name: self._seconds(given.get(name, 0.0), f"{where}.{name}") for name in names}
        power, off_s = self._power(item, variables, where)
        self._check_safe(item, where)
        changed = tuple(name for name, value in settings.items() if self._state.get(name) != value)
        wait = given.get("wait_settled", changed)
        assert isinstance(wait, tuple)
        self._check_settings(settings, wait, where)
        self._state = {name: value for name, value in self._state.items() if ENDS.get(name) not in settings} | settings
        if power is not None:
            self._is_powered = power != "off"
        if (record_s := times["record_s"]) > 0.0 and not self._is_powered:
            raise BadInput(f"{where}: records {record_s:g} s while the units have no power; switch them on before")
        if len(self._steps) >= _MOST_STEPS:
            raise BadInput(f"{where}: more than {_MOST_STEPS:,} steps; look at the loops around it")
        prompt = None
        if (asked := item.prompt) is not None:
            where_asked = f"{where}.prompt"
            en, zh = (text_of(getattr(asked, name), variables, f"{where_asked}.{name}") for name in ("en", "zh"))
            prompt = Names(en=en, zh=zh)
        words = self._words(item, given, times["settle_s"], variables, where)
        self._steps.append(
            PlannedStep(
                number=len(self._steps) + 1, words=words, settings=settings, wait_settled=wait, power=power,
                off_s=off_s, prompt=prompt, part=part, key=key, **times,
            )
        )  # fmt: skip

    def _words(
        self, item: Item, given: dict[str, object], settle_s: float, variables: Variables, where: str
    ) -> StepWords:
        assert item.name is not None
        now = self._state
        position = given.get("position") or (f"{now['angle']:g} deg" if "angle" in now else None)
        repeat = given.get("repeat")
        shakes = now.get("amplitude", 0.0) != 0.0
        return StepWords(
            procedure=self._procedure,
            step=text_of(item.name, variables, f"{where}.name"),
            repeat=None if repeat is None else int(repeat),  # type: ignore[call-overload]
            position=position,  # type: ignore[arg-type]
            axis=given.get("axis"),  # type: ignore[arg-type]
            phase=given.get("phase"),  # type: ignore[arg-type]
            rate_command_deg_per_s=now.get("rate"),
            temperature_command_deg_c=now.get("temperature"),
            frequency_hz=now["frequency"] if shakes else None,
            amplitude=now["amplitude"] if shakes else None,
            settle_s=settle_s or None,
            room=given.get("room") or None,  # type: ignore[arg-type]
        )

    def _seconds(self, value: object, where: str) -> float:
        assert isinstance(value, float)
        if not 0.0 <= value <= _LONGEST_S:
            raise BadInput(f"{where}: {value:g} s; expected are 0 to {_LONGEST_S:g} s (a year)")
        return value

    def _power(self, item: Item, variables: Variables, where: str) -> tuple[Power | None, float]:
        """The switching of the power, and the seconds without it."""
        power = "none" if item.power is None else text_of(item.power, variables, f"{where}.power")
        if power not in _POWER:
            raise BadInput(f"{where}.power: {power!r} is none of {', '.join(_POWER)}")
        off_s = 0.0
        if item.off_s is not None:
            off_s = self._seconds(number_of(item.off_s, variables, f"{where}.off_s"), f"{where}.off_s")
        if power == "cycle" and off_s == 0.0:
            raise BadInput(f"{where}: power is cycled without off_s, the seconds that the units are off")
        if off_s > 0.0 and item.power in {None, "on", "none"}:
            raise BadInput(f'{where}.off_s: the units are not switched off here; say power = "cycle" or "off"')
        if power == "none":
            return None, 0.0
        return power, off_s if power != "on" else 0.0  # type: ignore[return-value]

    def _check_safe(self, item: Item, where: str) -> None:
        """An operator is not called to a table that moves."""
        rate, amplitude = (self._state.get(name, 0.0) for name in ("rate", "amplitude"))
        if item.prompt is not None and (rate != 0.0 or amplitude != 0.0):
            moves, key = (f"turns at {rate:g} deg/s", "rate") if rate != 0.0 else ("vibrates", "amplitude")
            raise BadInput(
                f"{where}.prompt: an operator is called while the table {moves}; "
                f"put a step with {key}_deg_per_s = 0 before it"
            )

    def _check_settings(self, settings: dict[str, float], wait: tuple[str, ...], where: str) -> None:
        for name in wait:
            if name not in SETTINGS:
                near = near_name(name, SETTINGS)
                raise BadInput(f"{where}.wait_settled: {name!r} is no setting{near}; there is {', '.join(SETTINGS)}")
            if name not in settings and name not in self._state:
                raise BadInput(f"{where}.wait_settled: {name} has not been set to anything before")
        if "rate" in settings and "angle" in settings:
            raise BadInput(f"{where}: a table turns or stands at an angle, it cannot be set to both in one step")
        if not settings.get("frequency", 1.0) > 0.0:
            raise BadInput(f"{where}.frequency_hz: {settings['frequency']:g} Hz is not positive")
        if settings.get("amplitude", 0.0) < 0.0:
            raise BadInput(f"{where}.amplitude_deg_per_s: {settings['amplitude']:g} deg/s is negative")
        if settings.get("amplitude", 0.0) > 0.0 and "frequency" not in {**self._state, **settings}:
            raise BadInput(f"{where}.amplitude_deg_per_s: an amplitude without a frequency_hz")


def _filled(item: Item, variables: Variables, where: str) -> dict[str, object]:
    """The settings, times and words of an item, as numbers and texts."""
    found: dict[str, object] = {}
    for name in _INHERITED:
        value = getattr(item, name)
        if value is None:
            continue
        if name in {"position", "axis", "phase"}:
            found[name] = text_of(value, variables, f"{where}.{name}")
        elif name in {"room", "wait_settled"}:
            found[name] = value
        else:
            found[name] = number_of(value, variables, f"{where}.{name}")
    return found
