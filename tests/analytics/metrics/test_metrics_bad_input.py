"""What metrics say of records that are damaged, odd or too small: a reason, never a wrong number; the others go on."""

import json
import math
from typing import Any
from uuid import UUID

import numpy as np
import pyarrow as pa
import pytest

from analytics.step_records.step_table import read_kept, write_kept
from storage.segments.records import SAMPLES, LogRecord
from storage.specifications.specification import parse_specification
from storage.sql.catalog import Catalog
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords
from stream.identity import sample_key
from stream.wire.batches import encode_batch
from tests.analytics.conftest import PLACE, START_NS, TestedUnits

SECOND_NS = 10**9
RATES = [sign * rate for rate in (1, 2, 5, 10, 20, 30, 50, 70, 100, 150, 200) for sign in (1, -1)]


def turn(
    tested: TestedUnits, unit: str, *, scale: float = 1.0, noise: float = 1e-3, n: int = 20, measure: str = "deg/s"
) -> None:
    """A scale-factor run `r-UNIT` of all rates, with the table at rest before and after them."""
    rng = np.random.default_rng(7)
    run, now = f"r-{unit}", START_NS
    tested.run(run, procedure="scale_factor")
    for rate in (0, *RATES, 0):
        values = scale * rate + rng.normal(0.0, noise, n)
        now = tested.step(
            run, unit, values, t0_ns=now, unit_of_measure=measure, procedure="scale_factor",
            rate_command_deg_per_s=float(rate),
        )  # fmt: skip


def rows_of(catalog: Catalog) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = catalog.reader("select * from unit_metrics").read_all().to_pylist()
    return rows


def test_steps_of_one_sample_are_points_of_a_line_without_an_interval_of_their_own(tested: TestedUnits) -> None:
    turn(tested, "U1", n=1)
    found = tested.metrics("scale_factor", "scale_factor_nonlinearity")
    scale = found["scale_factor"]
    assert scale[0]["value"] == pytest.approx(1.0, abs=1e-4)
    assert scale[0]["lo"] < scale[0]["value"] < scale[0]["hi"]
    for row in found["scale_factor_nonlinearity"]:
        assert row["value"] > 0
        assert (row["lo"], row["hi"], row["standard_uncertainty"]) == (None, None, None)


@pytest.mark.long
def test_an_output_that_does_not_answer_has_reasons_and_no_infinite_number(tested: TestedUnits) -> None:
    turn(tested, "DEAD", scale=0.0, noise=0.0)
    with tested.catalog() as catalog:
        rows = rows_of(catalog)
        assert len(catalog.rows("select parameters->>'$.output' from unit_metrics where metric = 'fitted_zero'")) == 2
    by_metric = {row["metric"]: row for row in rows}
    assert by_metric["scale_factor"]["value"] is None
    assert "the output is 0 at every rate: the axis does not answer" in by_metric["scale_factor"]["reason"]
    for name in ("fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry"):
        assert by_metric[name]["value"] is None
        assert "the axis does not answer" in by_metric[name]["reason"]
    for row in rows:
        numbers = [row[name] for name in ("value", "lo", "hi", "standard_uncertainty", "freedom")]
        assert all(each is None or math.isfinite(each) for each in numbers), row["metric"]
        json.loads(row["parameters"], parse_constant=pytest.fail)


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e150, 1e-150, 1e300])
def test_numbers_of_any_size_are_measured_and_spare_the_other_units(tested: TestedUnits, scale: float) -> None:
    turn(tested, "ODD", scale=scale, noise=scale * 1e-3, measure="mV")
    turn(tested, "U1")
    with tested.catalog() as catalog:
        found = {row["unit"]: row for row in rows_of(catalog) if row["metric"] == "scale_factor"}
    assert found["ODD"]["value"] == pytest.approx(scale, rel=1e-4)
    assert found["U1"]["value"] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.long
def test_a_frozen_output_is_not_perfectly_stable(tested: TestedUnits) -> None:
    tested.run("r1", procedure="static_bias")
    tested.step("r1", "U1", np.full(3700, 0.25), t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias")
    found = tested.metrics("bias_stability", "bias_stability_averaged", "bias")
    for name in ("bias_stability", "bias_stability_averaged"):
        for row in found[name]:
            assert (row["value"], row["lo"]) == (None, None)
            assert row["reason"].startswith("all 3700 samples are alike")
    assert found["bias"][0]["value"] == 0.25


@pytest.mark.long
def test_a_time_zone_that_nobody_knows_takes_only_the_day(tested: TestedUnits) -> None:
    rng = np.random.default_rng(3)
    for run, zone in (("r1", "Mars/Olympus"), ("r2", "asia/shanghai")):
        tested.run(run, procedure="static_bias", time_zone=zone)
        tested.step(run, run, rng.normal(1, 0.1, 3700), t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias")
    with tested.catalog() as catalog:
        found = catalog.rows("select unit, day::varchar, mean_deg_per_h from static_steps order by unit")
    assert [(unit, day) for unit, day, _ in found] == [("r1", None), ("r2", "2025-11-21")]
    assert all(bias == pytest.approx(1.0, abs=0.01) for _, _, bias in found)


@pytest.mark.long
@pytest.mark.parametrize("text", ["somewhere", "95", "nan"])
def test_a_latitude_that_is_none_leaves_the_earth_rate_in(tested: TestedUnits, text: str) -> None:
    tested.run("r1", procedure="static_bias", latitude_deg=text)  # type: ignore[arg-type]
    values = np.random.default_rng(4).normal(1, 0.1, 3700)
    tested.step("r1", "U1", values, t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias", position="IRA_up")
    raw, corrected = sorted(tested.metric("bias"), key=lambda row: row["earth_rate"])
    assert (raw["earth_rate"], corrected["earth_rate"]) == ("none", "removed")
    assert raw["value"] == pytest.approx(values.mean(), rel=1e-9)
    assert "no latitude of the station" in corrected["reason"]


@pytest.mark.long
def test_repeats_of_too_few_rates_say_so(tested: TestedUnits) -> None:
    rng, now = np.random.default_rng(5), START_NS
    tested.run("r1", procedure="scale_factor_repeatability")
    for repeat in (1, 2):
        for rate in (10.0, -10.0):
            now = tested.step(
                "r1", "U1", rate + rng.normal(0, 1e-3, 20), t0_ns=now, unit_of_measure="deg/s", repeat=repeat,
                procedure="scale_factor_repeatability", rate_command_deg_per_s=rate,
            )  # fmt: skip
    rows = tested.metric("scale_factor_repeatability")
    assert {row["value"] for row in rows} == {None}
    assert all("0 scale factors measured" in row["reason"] and "11 in each" in row["reason"] for row in rows)


@pytest.mark.long
def test_repeats_of_a_dead_output_say_so(tested: TestedUnits) -> None:
    now = START_NS
    tested.run("r1", procedure="scale_factor_repeatability")
    for repeat in (1, 2):
        for rate in (0, *RATES, 0):
            now = tested.step(
                "r1", "U1", np.zeros(5), t0_ns=now, unit_of_measure="deg/s", repeat=repeat,
                procedure="scale_factor_repeatability", rate_command_deg_per_s=float(rate),
            )  # fmt: skip
    reasons = {row["reason"] for row in tested.metric("scale_factor_repeatability") if row["standard"] == "JJF2014"}
    assert {reason.partition("; ")[0] for reason in reasons} == {"0 scale factors measured, 2 or more are asked for"}
    assert all("the output is 0 at every rate: the axis does not answer" in reason for reason in reasons)


@pytest.mark.long
def test_power_ons_without_a_date_are_not_said_to_be_of_different_days(tested: TestedUnits) -> None:
    rng = np.random.default_rng(6)
    for run in ("r1", "r2"):
        tested.run(run, procedure="static_bias", date_known=False)
        tested.step(run, "U1", rng.normal(1, 0.1, 3700), t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias")
    reasons = {row["kind"]: row["reason"] for row in tested.metric("bias_repeatability") if row["reason"]}
    assert "the date is unknown" in reasons["run_to_run"]


@pytest.mark.long
def test_steps_that_are_alike_count_once_each(tested: TestedUnits) -> None:
    values = np.random.default_rng(8).normal(1, 0.1, 3700)
    tested.run("r1", procedure="static_bias")
    tested.samples("r1", "U1", "rate", values, t0_ns=START_NS, dt_ns=SECOND_NS)
    for _ in range(2):
        begun = StepStarted(run="r1", t_ns=START_NS, unit="U1", words=StepWords(procedure="static_bias"))
        tested.document(begun)
        end_ns = START_NS + 3699 * SECOND_NS
        tested.document(StepEnded(run="r1", t_ns=end_ns, unit="U1", step_uid=begun.uid))
    rows = tested.metric("bias")
    assert sorted(row["steps"] for row in rows) == [[1], [2]]
    assert all(row["value"] == pytest.approx(values.mean(), rel=1e-9) for row in rows)


@pytest.mark.long
def test_a_step_that_ended_before_its_settle_time_is_told(tested: TestedUnits) -> None:
    tested.run("r1", procedure="static_bias")
    tested.step("r1", "U1", np.ones(50), t0_ns=START_NS, procedure="static_bias", settle_s=3600.0)
    with tested.catalog() as catalog:
        ((n, reason),) = catalog.rows("select n, reason from step_means")
    assert (n, reason) == (0, "the step ended before its settle time")
    (row,) = tested.metric("bias")
    assert (row["value"], row["reason"]) == (None, "no sample in the evaluated part of the step")


@pytest.mark.long
@pytest.mark.parametrize("damage", [b"", b"PAR1 this is none", b"\0" * 4096])
@pytest.mark.parametrize("file", ["steps.parquet", "unit_metrics.parquet"])
def test_damaged_records_are_made_anew(tested: TestedUnits, file: str, damage: bytes) -> None:
    turn(tested, "U1")
    with tested.catalog() as catalog:
        before = rows_of(catalog)
    path = tested.store.folder / "metrics" / file
    path.write_bytes(damage)
    with Catalog(tested.store) as catalog:
        assert rows_of(catalog) == before
    assert path.stat().st_size > 1000


@pytest.mark.long
@pytest.mark.parametrize("file", ["steps.parquet", "unit_metrics.parquet"])
def test_records_of_another_version_are_made_anew(tested: TestedUnits, file: str) -> None:
    turn(tested, "U1")
    with tested.catalog() as catalog:
        before = rows_of(catalog)
    path = tested.store.folder / "metrics" / file
    kept = read_kept(path)
    assert kept is not None
    for other in (
        pa.table({"run": ["r1"]}),
        kept.drop_columns([kept.column_names[-1]]),
        kept.drop_columns(["unit"]),
        kept.rename_columns(["run" if name == "signal" else name for name in kept.column_names]),
        kept.append_column("later", pa.nulls(kept.num_rows, pa.string())),
        kept.set_column(kept.column_names.index("n"), "n", pa.array(["many"] * kept.num_rows)),
    ):
        write_kept(path, other)
        with Catalog(tested.store) as catalog:
            assert rows_of(catalog) == before


@pytest.mark.long
def test_what_cannot_be_kept_is_right_all_the_same(tested: TestedUnits) -> None:
    turn(tested, "U1")
    with tested.catalog() as catalog:
        before = rows_of(catalog)
    folder = tested.store.folder / "metrics"
    for each in folder.iterdir():
        each.unlink()
    folder.rmdir()
    folder.write_bytes(b"")  # no folder can be made here
    with Catalog(tested.store) as catalog:
        assert rows_of(catalog) == before


@pytest.mark.parametrize(
    "line",
    [
        "scale_factor = nan",
        "scale_factor = 0.0",
        "max_rate_deg_per_s = inf",
        "average_s = inf",
        "average_s = 1e-12",
        "nonlinearity_ppm = -1.0",
    ],
)
def test_numbers_of_a_product_that_nothing_can_be_divided_by_are_refused(line: str) -> None:
    with pytest.raises(BadInput, match=line.split()[0]):
        parse_specification(f'revision = "A"\n[product."FOG-70"]\n{line}'.encode(), "spec.toml")


@pytest.mark.long
def test_irregular_samples_of_short_steps_all_count(tested: TestedUnits) -> None:
    rng, t_ns, means = np.random.default_rng(9), START_NS, []
    tested.run("r1", procedure="scale_factor")
    key = sample_key(PLACE, "U1", "rate")
    for at, rate in enumerate(RATES):
        words = StepWords(procedure="scale_factor", rate_command_deg_per_s=float(rate))
        begun = StepStarted(run="r1", t_ns=t_ns, unit="U1", words=words)
        tested.document(begun)
        values = rate + rng.normal(0, 0.01, 7)
        times_ns = t_ns + np.cumsum(rng.integers(5 * 10**7, 15 * 10**7, 7))
        batch = SampleBatch(
            "U1", "rate", "r1", UUID(int=1), 7 * at, int(times_ns[0]), 10**8, "deg/s", values=values, times_ns=times_ns,
            irregular=True,
        )  # fmt: skip
        tested._append(LogRecord(key, SAMPLES, batch.last_ns + 10**6, batch.t0_ns, encode_batch(batch)))
        tested.document(StepEnded(run="r1", t_ns=batch.last_ns, unit="U1", step_uid=begun.uid))
        means.append(values.mean())
        t_ns = batch.last_ns + 10**8
    (row,) = [row for row in tested.metric("scale_factor") if row["standard"] == "JJF2014"]
    assert row["n"] == 7 * len(RATES)
    assert row["value"] == pytest.approx(np.polyfit(RATES, means, 1)[0], rel=1e-9)
