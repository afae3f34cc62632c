"""What a trace says of bad input: dead outputs, copies, fill values, everything held out, numbers of no size."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.commands.closed_loop.diagnose import noise_of
from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.blocks.record_checks import check_runs, copied_runs, copies_left_out
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import number
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.model_text import parse_model
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from analytics.loop.unit_diagnosis import diagnose_units
from analytics.loop.unit_reduction import Question, reduce_units
from stream.batch import FloatArray
from stream.errors import BadInput, NotFound
from tests.analytics.conftest import SECOND_NS, TestedUnits

MODEL = ErrorModel.parse("rate = bias + temperature")
BLOCKS = 120
DAY_NS = 86_400 * 10**9
START_NS = 1_763_683_200 * 10**9


def one_run(number: int, value: FloatArray) -> RunBlocks:
    warm = 25.0 + 10.0 * np.sin(np.arange(BLOCKS) / 20.0 + number)
    channels = {"temperature": Channel(warm, np.full(BLOCKS, 0.01), "degC")}
    ones = np.ones(BLOCKS)
    return RunBlocks(
        "U1", f"r{number}", "rate", np.arange(BLOCKS), 30.0, START_NS + number * DAY_NS, value, 300 * ones.astype(int),
        0.01 * ones, "deg/h", channels,
    )  # fmt: skip


def noisy_runs(count: int = 6) -> list[RunBlocks]:
    rng = np.random.default_rng(3)
    return [one_run(each, 1.0 + 0.1 * rng.standard_normal(BLOCKS)) for each in range(count)]


def test_a_line_in_one_run_is_told_with_its_amplitude() -> None:
    runs = noisy_runs()
    line = 1.0 * np.sin(2.0 * np.pi * np.arange(BLOCKS) * 30.0 / 200.0)
    runs[1] = one_run(1, np.asarray(runs[1].value + line))
    found = diagnose(runs, MODEL)
    assert found.verdict is ModelVerdict.UNREPLICATED
    seen = {each["name"]: each for each in found.document()["unreplicated"]}
    # over the four training runs, three of which do not have it: 1 deg/h over sqrt(4)
    assert seen["periodic_line"]["coefficient"] == pytest.approx(0.5, rel=0.15)
    assert seen["periodic_line"]["unit_of_measure"] == "deg/h"


@pytest.mark.parametrize("value", [0.0, 7.25])
def test_an_output_that_stands_still_is_not_traced(value: float) -> None:
    runs = [one_run(each, np.full(BLOCKS, value)) for each in range(4)]
    found = diagnose(runs, MODEL)
    assert found.verdict is ModelVerdict.NOT_ENOUGH_DATA
    assert "dead or stuck" in found.missing[0]


def test_all_runs_held_out_leave_nothing_to_fit() -> None:
    runs = noisy_runs(3)
    with pytest.raises(BadInput, match="all runs"):
        diagnose(runs, MODEL, holdout=["r0", "r1", "r2"])


def test_too_little_beside_the_runs_held_out_is_said() -> None:
    runs = noisy_runs(3)
    short = runs[0]
    few = {"temperature": Channel(short.mean("temperature")[:5], np.full(5, 0.01), "degC")}
    runs[0] = replace(
        short, slot=short.slot[:5], value=short.value[:5], n=short.n[:5], white_variance=short.white_variance[:5],
        channels=few,
    )  # fmt: skip
    found = diagnose(runs, MODEL, holdout=["r1", "r2"])
    assert found.verdict is ModelVerdict.NOT_ENOUGH_DATA
    assert found.missing[0].startswith("without the held-out runs: 5 blocks")


def test_dead_runs_are_noted_and_copies_left_out() -> None:
    runs = noisy_runs(4)
    assert check_runs(runs) == []
    assert copied_runs(runs) == {}
    runs += [one_run(4, runs[1].value), one_run(5, np.zeros(BLOCKS)), one_run(6, runs[1].value)]
    (still,) = check_runs(runs)
    assert (still.what, still.runs, still.is_limit) == ("still", ("r5",), True)
    copies = copied_runs(runs)
    unit = runs[0].unit
    assert copies == {(unit, "r4"): (unit, "r1"), (unit, "r6"): (unit, "r1")}
    why = "they are copies, sample for sample (r4 of r1, r6 of r1), and would confirm each other"
    assert str(copies_left_out(copies, len(runs)).sentence) == f"29% of the runs left out: {why}"


def test_a_declared_term_that_hardly_varies_is_named_with_what_it_costs() -> None:
    rng = np.random.default_rng(8)
    runs = noisy_runs()
    assert not any("hardly varies" in str(each) for each in diagnose(runs, MODEL).limits)
    level = [Channel(20.0 + 2e-3 * rng.normal(size=BLOCKS), np.full(BLOCKS, 0.01), "degC") for _ in runs]
    flat = [replace(run, channels={"temperature": each}) for run, each in zip(runs, level, strict=True)]
    (said,) = [str(each) for each in diagnose(flat, MODEL).limits if "hardly varies" in str(each)]
    assert "term temperature of the declared model" in said
    assert "deg/h/degC, and beside it the bias is uncertain by" in said


def test_one_file_under_several_names_is_one_run(tested: TestedUnits) -> None:
    rng = np.random.default_rng(6)
    values = rng.normal(0.0, 1.0, (2, 6000))
    for name, rates in (("r1", values[0]), ("r2", values[1]), ("r3", values[0]), ("r4", values[0])):
        tested.run(name)
        tested.samples(name, "U1", "rate", rates, t0_ns=START_NS, dt_ns=10**8, unit_of_measure="deg/h")
    with tested.catalog() as catalog:
        reduced = BlockReducer(catalog, "rate").reduce("U1")
    assert sorted(run.run for run in reduced.runs) == ["r1", "r2"]
    assert [(each.share, "r3 of r1, r4 of r1" in str(each.why)) for each in reduced.left_out] == [(0.5, True)]


def test_a_measurement_under_the_names_of_two_units_counts_once(tested: TestedUnits) -> None:
    rng = np.random.default_rng(6)
    own = rng.normal(0.0, 1.0, (5, 1200))
    recorded = {"U1": (own[0], own[1]), "U2": (own[2], own[0]), "U3": (own[1], own[0])}
    for place in (0, 1):
        tested.run(f"r{place}")
        for unit, runs in recorded.items():
            tested.samples(f"r{place}", unit, "rate", runs[place], t0_ns=START_NS, dt_ns=SECOND_NS)
    with tested.catalog() as catalog:
        read = reduce_units(catalog, ["U1", "U2", "U3"], Question("rate = bias"))
    assert {unit: [run.run for run in each.runs] for unit, each in read.units.items()} == {
        "U1": ["r0", "r1"],
        "U2": ["r0"],
    }
    (lost,) = read.units["U2"].left_out
    assert str(lost.sentence).startswith(
        "50% of the runs left out: they are copies, sample for sample (r1 of r0 of unit U1)"
    )
    assert "r0 of r1 of unit U1" in read.failed["U3"]
    (note,) = [each for each in read.units["U1"].notes if each.what == "copied_elsewhere"]
    assert "run r0 as r1 of unit U2" in note.text
    assert note.is_limit


@pytest.mark.long
def test_one_bad_unit_does_not_end_the_trace_of_others(tested: TestedUnits) -> None:
    rng = np.random.default_rng(5)
    for name in ("r1", "r2", "r3"):
        tested.run(name)
        good, filled = rng.normal(0.0, 1.0, (2, 6000))
        filled[7:57] = 1e300
        for unit, rate in (("U1", good), ("U2", filled)):
            tested.samples(name, unit, "rate", rate, t0_ns=START_NS, dt_ns=10**8, unit_of_measure="deg/h")
    with tested.catalog() as catalog:
        found = diagnose_units(catalog, ["U1", "U2"], Question("rate = bias"))
        assert list(found.units) == ["U1"]
        assert "reaches 1.6" in found.failed["U2"]
        with pytest.raises(BadInput, match="which no sensor gives"):
            diagnose_units(catalog, ["U2"], Question("rate = bias"))
        with pytest.raises(BadInput, match="not there in any unit: r9"):
            diagnose_units(catalog, ["U1", "U2"], Question("rate = bias", holdout=("r9",)))
        with pytest.raises(NotFound, match="U1: all its runs are to be held out"):
            diagnose_units(catalog, ["U1", "U2"], Question("rate = bias", holdout=("r1", "r2", "r3")))
        for block_s in (1e-12, 1e-9):
            with pytest.raises(BadInput, match="give blocks from"):
                BlockReducer(catalog, "rate", block_s=block_s).reduce("U1")
        with pytest.raises(BadInput, match="at most"):
            BlockReducer(catalog, "rate", block_s=1e300)


@pytest.mark.long
def test_a_fill_value_in_every_run_blinds_no_trace(tested: TestedUnits) -> None:
    rng = np.random.default_rng(6)
    for at in range(6):
        tested.run(f"r{at}")
        warm = 25.0 + 10.0 * np.sin(np.arange(36_000) / 4000.0 + at)
        rate = rng.normal(10.0, 1.0, 36_000) + 2e-3 * (warm - 25.0) ** 2
        filled = rate.copy()
        filled[5000 + 100 * at] = -99999.0
        for unit, values in (("U1", rate), ("U2", filled)):
            signals = {"rate": (values, "deg/h"), "temperature": (warm, "degC")}
            tested.power_on(f"r{at}", unit, START_NS)
            tested.step(f"r{at}", unit, signals, t0_ns=START_NS + at * 10**13)
    with tested.catalog() as catalog:
        found = diagnose_units(catalog, ["U1", "U2"], Question("rate = bias + temperature"))
    clean, filled_too = (found.units[unit].diagnosis for unit in ("U1", "U2"))
    assert clean.names == filled_too.names == ("temperature_squared",)
    assert clean.noise is not None
    assert filled_too.noise is not None
    # each run has lost a block of 120: N stays within its own standard error, 1/sqrt(2 * 480)
    assert pytest.approx(clean.noise.N, rel=0.032) == filled_too.noise.N
    one, other = clean.effects[0].coefficients[0], filled_too.effects[0].coefficients[0]
    assert abs(one.value - other.value) < 0.1 * (one.hi - one.lo)
    assert [note.what for note in found.units["U2"].data.notes if note.what == "far_outside"] == ["far_outside"]


@pytest.mark.parametrize("text", ["N=1e-300,B=0,K=0,turn_on=0", "N=1,B=0,K=1e300,turn_on=0"])
def test_noise_of_no_size_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="no sensor's size"):
        noise_of(text)


def test_long_texts_and_endless_numbers_are_refused() -> None:
    with pytest.raises(BadInput, match="write at most") as reported:
        parse_model("rate = bias + " + "temperature+" * 20_000 + "temperature")
    assert len(str(reported.value)) < 200
    with pytest.raises(BadInput, match="not a number"):
        number({"time_constant": float("inf")}, "time_constant")
