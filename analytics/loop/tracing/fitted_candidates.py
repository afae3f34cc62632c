"""Fitted candidates of one round: what passed the screening, each fitted together with the noise, and its evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy import stats

from analytics.loop.effects.base import Kind, Role
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.candidates import Candidate, Candidates
from analytics.loop.tracing.evidence import PRICE, Replication, evidence, leave_one_out, one_degree
from analytics.loop.tracing.joint_fit import JointFit, fit_jointly
from analytics.loop.tracing.jump_scan import jump_column, scan_jumps
from analytics.loop.tracing.line_scan import line_columns, scan_lines
from analytics.loop.tracing.misfit import noise_inflation
from analytics.loop.tracing.record import Record, as_array, from_array
from analytics.loop.tracing.screening import Screen, Screened, family_p_value, screen
from stream.batch import FloatArray

ALPHA = 0.01
"""Family-wise chance of a false finding, for each of library and jumps."""
LINE_ALPHA = 0.001
"""The same for lines: whitened noise that is not quite white is most of all taken for a line."""
SCREENED, SCREENED_FROM_FEW = 1e-3, 2.0
"""P-value of the screening that is worth a fit: 0.001, or where tests are few twice what one of them has to reach."""
MOST_FITTED, MOST_FITTED_IN_FLEET = 10, 5
UNMASKED = 1e-4
MOST_UNMASKED = 8
SWALLOWED = 0.25
"""Logarithm by which a fitted noise coefficient exceeds the declared one when it may have swallowed an effect."""
EXCESS_AVERAGE_S, GROSS_EXCESS = 3600.0, 4.0
"""Ratio of variances of hourly averages, fitted over declared, beyond which the noise model is not trusted."""
LEAST_LEAD, LEAST_SHARE_OF_LEAD = 12.0, 0.03
"""Evidence, and share of a large effect's own, within which others are not told from it."""
ALIAS_SHARE_OF_LEAD = 0.25
"""The same of causes that the library calls aliases: as the rate of temperature and its difference between two places,
they follow one cause, and which of them is measured with less noise must not decide."""
_SAME_EVIDENCE = 6
"""Digits after the point beyond which evidence differs by rounding alone; then the name decides, on every machine."""
LINE, JUMP = "periodic_line", "jump"
LINE_MOST_FROM_ONE = 0.9


@dataclass(frozen=True)
class FittedCandidate:
    """One explanation of what is left.

    Parameters
    ----------
    name: Of the effect.
    kind: How it came into the search.
    role: Of its channels.
    parameters: Values of the shape parameters.
    candidate: None for a line or a jump.
    columns: On each record, in natural units.
    joint: Fit with it.
    likelihood_ratio: Twice the gain in log likelihood, noise fitted with and without it, over the inflation of the
        noise at its pace.
    degrees: Of freedom.
    evidence: On the common scale.
    replication: None for a jump, which happens once.
    replicates: Whether it counts as seen more than once.
    at_most: Evidence before noise at its pace was taken back; None where nothing was.
    """

    name: str
    kind: Kind
    role: Role
    parameters: dict[str, Any]
    candidate: Candidate | None
    columns: Sequence[FloatArray]
    joint: JointFit
    likelihood_ratio: float
    degrees: int
    evidence: float
    replication: Replication | None = None
    replicates: bool = True
    at_most: float | None = None

    @classmethod
    def of(
        cls,
        candidate: Candidate,
        columns: Sequence[FloatArray],
        joint: JointFit,
        likelihood_ratio: float,
        degrees: int,
        evidence: float,
    ) -> Self:
        """A fitted candidate, with the names of its effect."""
        return cls(
            name=candidate.effect.name,
            kind=candidate.effect.kind,
            role=candidate.effect.role,
            parameters=dict(candidate.shape),
            candidate=candidate,
            columns=columns,
            joint=joint,
            likelihood_ratio=likelihood_ratio,
            degrees=degrees,
            evidence=evidence,
        )

    def is_near(self, best: "FittedCandidate") -> bool:
        """Whether it may explain as much as the best one.

        Here the noise at its pace is no argument: a wrong shape makes an effect disagree between runs as well.
        """
        lead = best.lead
        if self.role is best.role is Role.CAUSE and (best.is_alias_of(self) or self.is_alias_of(best)):
            lead = max(lead, ALIAS_SHARE_OF_LEAD * best.evidence)
        return best.evidence - (self.evidence if self.at_most is None else self.at_most) < lead

    def is_alias_of(self, other: "FittedCandidate") -> bool:
        """Whether the other's effect names this one among those that look like it."""
        return other.candidate is not None and self.name in other.candidate.effect.aliases

    @property
    def lead(self) -> float:
        """Evidence by which it has to lead another to be told from it.

        The wrong one of two leads by L with a chance of at most Phi(-sqrt(L)), however alike they are: 1 in 3700 at 12,
        and an effect has some ten that are alike. Of a large effect a share of its own: channels are measured and forms
        are idealised no better than that.
        """
        return max(LEAST_LEAD, LEAST_SHARE_OF_LEAD * self.evidence)

    @property
    def significance(self) -> float:
        """As the z of a test of one degree of freedom."""
        return float(np.sqrt(one_degree(self.likelihood_ratio, self.degrees)))


def fitted_candidates(
    records: Sequence[Record],
    candidates: Candidates,
    base: JointFit,
    rng: np.random.Generator,
    taken: Sequence[str],
    *,
    with_events: bool = True,
) -> list[FittedCandidate]:
    """Everything that may be meant beside a fit, largest evidence first; what does not replicate included.

    Evidence of less than nothing counts as well: what has none of its own may be confounded with what has some.

    Parameters
    ----------
    records, candidates: The blocks, and what is tried on them.
    base: The model so far.
    rng: For the screening.
    taken: Effects that are in the model so far.
    with_events: Whether to scan for lines and jumps.
    """
    first = screen(candidates, base.hypothesis.designs, base.noises, rng, taken)
    found = []
    for group in _worth_fitting(records, candidates, base, rng, taken, first):
        fitted = _fitted(records, candidates, base, group, first)
        if fitted is not None and fitted.evidence > -PRICE:
            discounted = _discounted(records, fitted)
            found.append(replace(discounted, joint=discounted.joint.light()))
    if with_events:
        found += [each for each in (_line(records, base), _jump(records, base)) if each is not None]
    return sorted(found, key=lambda each: (-round(each.evidence, _SAME_EVIDENCE), each.name))


def _worth_fitting(
    records: Sequence[Record],
    candidates: Candidates,
    base: JointFit,
    rng: np.random.Generator,
    taken: Sequence[str],
    first: Screen,
) -> list[list[Screened]]:
    """Effects that passed the screening, each with its shapes, best first.

    Where the fitted noise exceeds the declared one it may have swallowed an effect (ageing in the turn-on scatter,
    warm-up in the random walk): a second screening at the declared noise unmasks it.
    """
    worth = max(SCREENED, SCREENED_FROM_FEW * ALPHA / first.tests)
    chosen = [group for group in first.by_effect() if group[0].p_value < worth]
    del chosen[MOST_FITTED if len(records) == 1 else MOST_FITTED_IN_FLEET :]
    noises = least_noises(records, base.noises)
    if noises is None:
        return chosen
    second = screen(candidates, base.hypothesis.designs, noises, rng, taken)
    names = {group[0].candidate.effect.name for group in chosen}
    others = [group for group in second.by_effect() if group[0].candidate.effect.name not in names]
    return chosen + [group for group in others if group[0].p_value < UNMASKED][:MOST_UNMASKED]


def least_noises(records: Sequence[Record], noises: Sequence[NoiseCoefficients]) -> Sequence[NoiseCoefficients] | None:
    """The lesser of fitted and declared noise of each record; None where no fitted one may have swallowed an effect."""
    least = [_least(noise, record) for noise, record in zip(noises, records, strict=True)]
    if all(each is None for each in least):
        return None
    return [noise if each is None else each for noise, each in zip(noises, least, strict=True)]


def _least(noise: NoiseCoefficients, record: Record) -> NoiseCoefficients | None:
    """The lesser of fitted and declared noise, where the fitted one is much larger."""
    fitted, declared = as_array(noise), record.prior.values
    active = declared > 0
    if not np.any(np.log(fitted[active][1:] / declared[active][1:]) > SWALLOWED):
        return None
    return from_array(np.minimum(fitted, declared))


def _fitted(
    records: Sequence[Record], candidates: Candidates, base: JointFit, group: Sequence[Screened], screened: Screen
) -> FittedCandidate | None:
    """Fit the two best shapes of an effect and keep the better one; None where it fails the family-wise test."""
    best: FittedCandidate | None = None
    for result in group[: 2 if len(records) == 1 else 1]:
        item = result.candidate
        columns = candidates.of_all(item)
        joint = fit_jointly(records, base.hypothesis.with_common(columns), base.noises)
        ratio = 2 * (joint.log_likelihood - base.log_likelihood)
        p_value = float(stats.chi2.sf(max(ratio, 0.0), result.degrees))
        if family_p_value(p_value, screened.tests) >= ALPHA or (best and ratio <= best.likelihood_ratio):
            continue
        degrees = result.degrees + (len(group) > 1)
        evidence = _evidence(records, joint, ratio, degrees, item.effect.kind)
        best = FittedCandidate.of(item, columns, joint, ratio, degrees, evidence)
    return best


def _evidence(records: Sequence[Record], joint: JointFit, ratio: float, degrees: int, kind: Kind) -> float:
    """Evidence of a fit; it pays twice where its noise is far from the declared one: that model is not trusted."""
    excess = [
        record.noise_model.average_variance(noise, EXCESS_AVERAGE_S)
        / record.noise_model.average_variance(record.prior.center, EXCESS_AVERAGE_S)
        for record, noise in zip(records, joint.noises, strict=True)
    ]
    price = PRICE if max(excess) > GROSS_EXCESS else 0.0
    return evidence(ratio, degrees, is_function=kind is Kind.FUNCTION) - price


def _discounted(records: Sequence[Record], fitted_candidate: FittedCandidate) -> FittedCandidate:
    """See whether the replicates bear an effect out; take back what noise at its pace can explain."""
    replicates = [record.stack.replicate for record in records]
    runs = [record.stack.run_number for record in records]
    width = fitted_candidate.columns[0].shape[1]
    replication = leave_one_out(fitted_candidate.joint, replicates, width)
    if not replication.replicates:
        return replace(fitted_candidate, replication=replication, replicates=False)
    ratio = fitted_candidate.likelihood_ratio / noise_inflation(fitted_candidate.joint, replicates, runs, width)
    return replace(
        fitted_candidate,
        likelihood_ratio=ratio,
        evidence=_evidence(records, fitted_candidate.joint, ratio, fitted_candidate.degrees, fitted_candidate.kind),
        replication=replication,
        at_most=fitted_candidate.evidence,
    )


def _line(records: Sequence[Record], base: JointFit) -> FittedCandidate | None:
    line = scan_lines(records, base.residuals)
    if line is None or line.family_p_value >= LINE_ALPHA:
        return None
    columns = tuple(line_columns(record, line.frequency_hz) for record in records)
    joint = fit_jointly(records, base.hypothesis.with_own(columns), base.noises)
    ratio = 2 * (joint.log_likelihood - base.log_likelihood)
    fitted_p_value = float(stats.chi2.sf(max(ratio, 0.0), 2 * line.powers.size))
    strength = float(stats.chi2.isf(max(line.p_value, fitted_p_value, 1e-300), 1))
    gain = strength - 2 * np.log(sum(map(len, records)))
    if gain <= 0:
        return None
    return FittedCandidate(
        name=LINE,
        kind=Kind.LINE,
        role=Role.CAUSE,
        parameters={"frequency_hz": line.frequency_hz},
        candidate=None,
        columns=columns,
        joint=joint,
        likelihood_ratio=strength,
        degrees=1,
        evidence=gain,
        replicates=line.powers.size == 1 or line.largest_share < LINE_MOST_FROM_ONE,
    )


def _jump(records: Sequence[Record], base: JointFit) -> FittedCandidate | None:
    jump = scan_jumps(records, base)
    if jump is None or jump.family_p_value >= ALPHA:
        return None
    columns = tuple(
        jump_column(record, jump.row) if number == jump.record else np.empty((len(record), 0))
        for number, record in enumerate(records)
    )
    joint = fit_jointly(records, base.hypothesis.with_own(columns), base.noises)
    ratio = 2 * (joint.log_likelihood - base.log_likelihood)
    gain = ratio - 3 * np.log(sum(map(len, records)))
    if gain <= 0:
        return None
    run = records[jump.record].stack.runs[jump.run]
    slot = records[jump.record].stack.slot[jump.row]
    return FittedCandidate(
        name=JUMP,
        kind=Kind.EVENT,
        role=Role.CAUSE,
        parameters={"run": run.run, "at_s": float(slot * run.block_s)},
        candidate=None,
        columns=columns,
        joint=joint,
        likelihood_ratio=ratio,
        degrees=1,
        evidence=gain,
    )
