"""Names and numbers of a report in English or Chinese: effects, parameters, coefficients with bounds."""

import math
from collections.abc import Sequence
from typing import Literal

from analytics.loop.bilingual import Bilingual, chinese
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import parameter_unit
from analytics.loop.effects.registry import effect
from analytics.loop.tracing.result.diagnosis_result import BiasTest, ConfoundedEffect, EffectCoefficient, FoundEffect
from analytics.loop.tracing.result.holdout import HoldoutSlope
from stream.quantities import format_unit

Language = Literal["en", "zh"]

_MOST_COLUMNS = 3
_LEAST_PERCENT = 1e-4  # of an error, below which a share is nothing
LEAST_SHARE = 1e-3  # of an error, below which a change is not worth a sentence
_USUAL_DIGITS, _MOST_DIGITS, _SMALL = 3, 15, 1e-3
_RUN = {"en": "run", "zh": "试验"}


def number(value: float | None) -> str:
    """A number with three digits; a dash if there is none.

    >>> number(0.51389), number(14538.2), number(2.1e-7), number(0.0), number(None)
    ('0.514', '14,538', '2.1e-07', '0', '\N{EN DASH}')
    """
    if value is None or not math.isfinite(value):
        return "\N{EN DASH}"
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.3g}"
    return f"{value:.3g}"


def percent(share: float) -> str:
    """A share of an error in percent, without its sign of percent; what is below 0.01 % is 0.

    >>> percent(0.856), percent(0.996), percent(0.0588), percent(-0.0031), percent(6.6e-18)
    ('86', '100', '5.9', '-0.31', '0')
    """
    if abs(share) < _LEAST_PERCENT:
        return "0"
    return f"{100 * share:.0f}" if abs(share) >= 0.1 else f"{100 * share:.2g}"


def measured(value: float, error: float) -> str:
    """A number to two digits of its standard uncertainty, and at least three digits.

    >>> measured(3600.195191, 0.00074), measured(0.0558, 0.000821), measured(3.0243, 0.05), measured(-14538.2, 120.0)
    ('3,600.19519', '0.05580', '3.024', '-14,538')
    >>> measured(3.0243, 0.0), measured(3.0243, float("nan"))
    ('3.02', '3.02')
    """
    if not (math.isfinite(value) and math.isfinite(error)) or value == 0 or error <= 0:
        return number(value)
    place = 1 - math.floor(math.log10(error))
    digits = math.floor(math.log10(abs(value))) + 1 + place
    if not _USUAL_DIGITS < digits <= _MOST_DIGITS:
        return number(value)
    return f"{value:,.{max(0, place)}f}" if abs(value) >= _SMALL else f"{value:.{digits}g}"


def sole_run(run: str, words: "Wording") -> str:
    """The sentence that one run alone shows an effect."""
    return words.of(
        f"run {run} alone shows it: without it the biases of the other runs do not",
        f"仅由试验{run}显示：去掉该次试验后，其余试验的零偏不再显示",
    )


def slope_text(slope: HoldoutSlope, digits: int = 2) -> str:
    """A slope with its standard error; with more digits where these would make both of them 0.

    >>> slope_text(HoldoutSlope("temperature", 0.98, 0.051, 0.1, True))
    '0.98 ± 0.05'
    >>> slope_text(HoldoutSlope("temperature", 3.3e-5, 2.4e-6, 0.1, False))
    '3.3e-05 ± 2.4e-06'
    """
    if max(abs(slope.slope), slope.slope_se) < 0.5 * 10.0**-digits:
        return f"{slope.slope:.3g} ± {slope.slope_se:.2g}"
    return f"{slope.slope:.{digits}f} ± {slope.slope_se:.{digits}f}"


class Wording:
    """Names in one language; the channels of `run` give the units of shape parameters."""

    def __init__(self, language: Language, run: RunBlocks | None = None) -> None:
        self.language: Language = language
        self._run = run

    def of(self, en: str, zh: str) -> str:
        """The text in this language."""
        return zh if self.language == "zh" else en

    def clause(self, text: Bilingual) -> str:
        """A clause as a sentence."""
        written = self.text(text)
        return written[0].upper() + written[1:] + self.of(".", "。")

    def each(self, *pairs: tuple[str, str]) -> tuple[str, ...]:
        """Texts in this language, such as the head of a table."""
        return tuple(self.of(*pair) for pair in pairs)

    def text(self, text: str) -> str:
        """A caveat, a note or a reason in this language."""
        return chinese(text) if self.language == "zh" else str(text)

    def listed(self, parts: Sequence[str], last: tuple[str, str] = ("and", "和")) -> str:
        """A list in a sentence.

        >>> Wording("en").listed(["a", "b", "c"], ("or", "或")), Wording("zh").listed(["甲", "乙"])
        ('a, b or c', '甲和乙')
        """
        if len(parts) < 2:
            return "".join(parts)
        comma, word = self.of(", ", "、"), self.of(f" {last[0]} ", last[1])
        return comma.join(parts[:-1]) + word + parts[-1]

    def name(self, name: str) -> str:
        """Name of an effect."""
        known = effect(name)
        return self.of(known.en, known.zh)

    def effect(self, found: FoundEffect | ConfoundedEffect) -> str:
        """Name of an effect with the values of its parameters."""
        parameters = self.parameters(found)
        return f"{self.name(found.name)} ({parameters})" if parameters else self.name(found.name)

    def parameters(self, found: FoundEffect | ConfoundedEffect) -> str:
        """Values of the shape parameters, without lists such as the knots of a free function."""
        known = {parameter.name: parameter for parameter in effect(found.name).parameters}
        parts = []
        for key, value in found.parameters.items():
            if isinstance(value, (list, tuple)):
                continue
            if key in known:
                parameter = known[key]
                unit = parameter.unit_of_measure if self._run is None else parameter_unit(parameter, self._run)
                parts.append(f"{self.of(parameter.en, parameter.zh)} {_short(value)} {format_unit(unit)}".rstrip())
            else:
                parts.append(f"{self.of(key, _RUN['zh']) if key == 'run' else key} {_short(value)}")
        return ", ".join(parts)

    def coefficient(self, found: FoundEffect) -> str:
        """Coefficients with their confidence bounds, or their number; from which runs, if others give another."""
        if len(found.coefficients) > _MOST_COLUMNS:
            count = len(found.coefficients)
            return self.of(f"{count} coefficients", f"{count}个系数")
        text = self.of("; ", "；").join(self._one(each) for each in found.coefficients)
        test = found.of_biases
        if test is None or test.value == found.coefficients[0].value:
            return text
        return text + self.of(" in the training runs", "（训练试验）")

    def _one(self, found: EffectCoefficient) -> str:
        head = f"{found.name} " if found.name else ""
        return f"{head}{self.size(found, found.unit_of_measure)}"

    def size(self, found: EffectCoefficient | BiasTest, unit_of_measure: str) -> str:
        """A coefficient with its bounds."""
        bounds = f"{number(found.lo)} {self.of('to', '至')} {number(found.hi)}"
        return f"{number(found.value)} ({bounds}) {format_unit(unit_of_measure)}"


def _short(value: object) -> str:
    return number(value) if isinstance(value, (int, float)) else str(value)
