"""Effects that a declared model lacks: coefficients, evidence, alternatives, detection limits."""

from typing import Any

import msgspec


class EffectCoefficient(msgspec.Struct, frozen=True):
    """A coefficient with its 95 % confidence bounds; `name` is that of its column, such as ``cos``."""

    name: str
    value: float
    lo: float
    hi: float
    unit_of_measure: str


class ConfoundedEffect(msgspec.Struct, frozen=True):
    """An effect that explains the data as well as the one found.

    Parameters
    ----------
    parameters: Values of its shape parameters.
    evidence_behind: Difference of evidence to the effect found, in chi-square; None if it was not fitted.
    role: cause, proxy or alias.
    separating_test, separating_test_zh: The measurement that separates the two.
    recorded: Whether its channels are recorded; an unrecorded cause cannot be excluded.
    coefficient: Its first coefficient, if fitted.
    implied, most: Of a clock error: its least size, and the largest plausible size.
    implied_unit: Unit of both.
    """

    name: str
    parameters: dict[str, Any]
    evidence_behind: float | None
    role: str
    separating_test: str
    separating_test_zh: str
    recorded: bool = True
    coefficient: float | None = None
    implied: float | None = None
    most: float | None = None
    implied_unit: str = ""

    @property
    def is_plausible(self) -> bool:
        """Whether the size that it needs is plausible."""
        return self.implied is None or self.most is None or self.implied <= self.most

    def document(self, beside: str) -> dict[str, Any]:
        """JSON form; `beside` is the name of the effect found."""
        implied = None
        if self.implied is not None:
            implied = {
                "value": self.implied,
                "most": self.most,
                "unit_of_measure": self.implied_unit,
                "plausible": self.is_plausible,
            }
        return {
            "name": self.name,
            "beside": beside,
            "parameters": self.parameters,
            "role": self.role,
            "recorded": self.recorded,
            "separating_test": self.separating_test,
            "implied": implied,
        }


class FoundEffect(msgspec.Struct, frozen=True):
    """An effect that the declared model lacks.

    Parameters
    ----------
    parameters: Values of its shape parameters.
    coefficients: Fitted to the training runs.
    significance: Equivalent z of a test with one degree of freedom; noise re-fitted with and without the effect.
    evidence: Equivalent chi-square of one degree less the multiplicity penalty.
    roles: Role of each of its channels: cause, proxy or alias.
    confounded: Effects that the data cannot separate from it.
    companions: Proxies that follow it.
    unknown_function_of: Channels on which the residual depends in another form; empty if the form fits.
    form_p_value, heterogeneity_p_value: Tests of the form, and of equal coefficients in all runs.
    largest_share: Share of the leave-one-run-out gain due to the best run.
    replicates: Whether it improves the prediction of runs that it was not fitted to.
    confirmed: Answer of the held-out runs; None if they cannot answer.
    by_run: First coefficient and its standard error in each run that excites it.
    error_share: Share of the squared held-out error that it explains; None if it predicts nothing.
    """

    name: str
    parameters: dict[str, Any]
    coefficients: tuple[EffectCoefficient, ...]
    significance: float
    evidence: float
    roles: dict[str, str]
    confounded: tuple[ConfoundedEffect, ...] = ()
    companions: tuple[str, ...] = ()
    unknown_function_of: tuple[str, ...] = ()
    form_p_value: float = 1.0
    heterogeneity_p_value: float = 1.0
    largest_share: float = 0.0
    replicates: bool = True
    confirmed: bool | None = None
    by_run: dict[str, tuple[float, float]] = {}
    error_share: float | None = None

    def document(self) -> dict[str, Any]:
        """JSON form: one coefficient as a number, several as lists in the order of `columns`."""
        each = self.coefficients
        document: dict[str, Any] = {"name": self.name, "parameters": self.parameters}
        if len(each) == 1:
            document["coefficient"] = each[0].value
        else:
            document |= {"columns": [one.name for one in each], "coefficient": [one.value for one in each]}
        document["unit_of_measure"] = each[0].unit_of_measure
        for bound in ("lo", "hi"):
            values = [getattr(one, bound) for one in each]
            document[bound] = values[0] if len(each) == 1 else values
        return document | {
            "significance": self.significance,
            "evidence": self.evidence,
            "roles": self.roles,
            "companions": list(self.companions),
            "unknown_function_of": list(self.unknown_function_of),
            "heterogeneity_p_value": self.heterogeneity_p_value,
            "confirmed": self.confirmed,
            "error_share": self.error_share,
            "by_run": {run: {"coefficient": value, "se": se} for run, (value, se) in self.by_run.items()},
        }


class DetectionLimit(msgspec.Struct, frozen=True):
    """Detection limit of an effect that was not found.

    Parameters
    ----------
    coefficient: Smallest coefficient that is found with a probability of 90 %.
    absent_above: Larger coefficients are excluded at 95 %.
    """

    coefficient: float
    absent_above: float
    unit_of_measure: str
