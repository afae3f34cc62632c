"""The error model: text and JSON both ways, columns, prediction, and what it refuses."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import coefficient_unit
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise, ModelTerm
from analytics.loop.tracing.whitening.whitener import NoiseModel, whitened_residual
from stream.batch import FloatArray
from stream.errors import BadInput

BLOCKS = 200


def run(channels: Mapping[str, tuple[FloatArray, str]], value: FloatArray | None = None, name: str = "r1") -> RunBlocks:
    n = BLOCKS
    zeros = np.zeros(n)
    return RunBlocks(
        unit="FOG-1",
        run=name,
        signal="rate",
        slot=np.arange(n),
        block_s=30.0,
        t0_ns=0,
        value=zeros if value is None else value,
        n=np.full(n, 300),
        white_variance=np.ones(n),
        unit_of_measure="deg/h",
        channels={name: Channel(mean, zeros, unit) for name, (mean, unit) in channels.items()},
    )


@pytest.fixture
def cycled() -> RunBlocks:
    """A run with a temperature, an input rate, and time since power-on."""
    t_s = np.asarray((np.arange(BLOCKS) + 0.5) * 30.0, np.float64)
    return run(
        {
            "temperature": (25.0 + 20.0 * np.sin(t_s / 2000.0), "degC"),
            "input_rate": (np.copysign(10.0, np.sin(t_s / 300.0)), "deg/s"),
            "time_since_power_on": (t_s, "s"),
            "compressor": (np.cos(t_s / 700.0), "count"),
        }
    )


@pytest.mark.parametrize(
    "text",
    [
        "bias",
        "rate = bias + scale_factor*input_rate + temperature",
        "rate_x = bias + warm_up(time_constant=1800)",
        "bias + temperature + channel:compressor",
        "bias + function_of_temperature(knots=[-20, 0, 20.5, 60])",
        "bias + temperature*supply_voltage",
    ],
)
def test_text_and_json_come_back(text: str) -> None:
    model = ErrorModel.parse(text)
    assert str(model) == text
    assert str(ErrorModel.parse(str(model))) == text
    assert ErrorModel.from_json(model.to_json()) == model


def test_spacing_does_not_matter() -> None:
    wide = ErrorModel.parse("  rate=bias+scale_factor * input_rate+warm_up( time_constant = 1.8e+3 )")
    assert str(wide) == "rate = bias + scale_factor*input_rate + warm_up(time_constant=1800)"
    assert wide == ErrorModel.parse("rate = bias + scale_factor + warm_up(time_constant=1800.0)")


def test_a_channel_that_is_no_effect_takes_part_in_proportion(cycled: RunBlocks) -> None:
    model = ErrorModel.parse("bias + compressor", cycled.channels)
    assert [term.name for term in model.terms] == ["bias", "channel:compressor"]
    np.testing.assert_allclose(model.columns(cycled)[:, 1], cycled.mean("compressor"))
    assert coefficient_unit(effect("channel:compressor"), "deg/h", cycled) == "deg/h/count"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("rate = bias + temprature", "did you mean temperature"),
        ("rate = bias + scale_factor*table_rate", "is written scale_factor\\*input_rate"),
        ("bias + zzzz", "a term is bias, an effect or a channel: bias, "),
        ("bias + compresor", "did you mean compressor"),
        ("bias ++ temperature", "a term is missing beside a '\\+'"),
        ("= bias", "no signal stands before '='"),
        ("bias + temperature + temperature", "temperature occurs twice"),
        ("bias + warm_up(time=1800)", "warm_up has no parameter time; it has time_constant"),
        ("bias + warm_up(1800)", "cannot be read; write them like"),
        ("bias + warm_up(time_constant=__import__('os'))", "cannot be read"),
        ("bias + temperature(order=2)", "temperature has no parameter order; it has none"),
        ("bias(order=2)", "bias has no parameter order"),
        ("bias + 2", "term '2' is not known"),
    ],
)
def test_what_cannot_be_read_is_told(text: str, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        ErrorModel.parse(text, ["compressor"])


def test_a_missing_channel_is_told(cycled: RunBlocks) -> None:
    model = ErrorModel.parse("bias + supply_current + temperature")
    with pytest.raises(BadInput, match=r"run r1, unit FOG-1: term .*supply_current.* needs channel supply_current"):
        model.columns(cycled)
    channels = {"温度" if name == "temperature" else name: each for name, each in cycled.channels.items()}
    with pytest.raises(BadInput, match=r"import 温度 under that name \(--rename 温度=temperature\), or"):
        ErrorModel.parse("bias + temperature").columns(replace(cycled, channels=channels))


def test_prediction_and_residual_are_the_sum_of_the_columns(cycled: RunBlocks) -> None:
    declared = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature")
    with pytest.raises(BadInput, match="has no coefficients yet"):
        declared.predict(cycled)
    fitted = declared.fitted([2.0, 3600.5, -0.3], np.diag([1.0, 4.0, 9.0]), unit_of_measure="deg/h")
    expected = 2.0 + 3600.5 * cycled.mean("input_rate") - 0.3 * (cycled.mean("temperature") - 25.0)
    np.testing.assert_allclose(fitted.predict(cycled), expected)
    np.testing.assert_allclose(fitted.residual(cycled), -expected)
    np.testing.assert_allclose(fitted.errors, [1.0, 2.0, 3.0])
    assert ErrorModel.from_json(fitted.to_json()) == fitted
    other = declared.fitted([2.0, 3600.5, -0.3], unit_of_measure="V")
    with pytest.raises(BadInput, match="the signal is in deg/h, the error model was fitted in V"):
        other.predict(cycled)


def test_nan_of_a_channel_is_nan_of_the_prediction_only_there(cycled: RunBlocks) -> None:
    temperature = cycled.mean("temperature").copy()
    temperature[40:60] = np.nan
    gap = run({"temperature": (temperature, "degC")})
    fitted = ErrorModel.parse("bias + temperature").fitted([1.0, 2.0])
    assert np.flatnonzero(np.isnan(fitted.predict(gap))).tolist() == list(range(40, 60))


def test_a_further_term_asks_for_a_new_fit() -> None:
    fitted = ErrorModel.parse("bias + temperature").fitted([1.0, 2.0], np.eye(2))
    longer = fitted.with_term("warm_up", {"time_constant": 600.0})
    assert str(longer) == "bias + temperature + warm_up(time_constant=600)"
    assert not longer.is_fitted
    assert longer.covariance == ()
    with pytest.raises(BadInput, match="temperature occurs twice"):
        fitted.with_term("temperature")


def test_a_shape_that_is_left_open_is_found(cycled: RunBlocks) -> None:
    model = ErrorModel.parse("bias + temperature + warm_up")
    assert not model.terms[2].is_shaped()
    with pytest.raises(BadInput, match=r"warm_up has no value of its parameters; write warm_up\(time_constant="):
        model.columns(cycled)
    planted = ModelTerm("warm_up", {"time_constant": 600.0}).columns(cycled)[:, 0]
    grid = sorted(shape["time_constant"] for shape in _shapes("warm_up", cycled))
    nearest = min(grid, key=lambda each: abs(np.log(each / 600.0)))
    value = 5.0 + 0.1 * cycled.mean("temperature") + 40.0 * planted
    channels = {name: (each.mean, each.unit_of_measure) for name, each in cycled.channels.items()}
    runs = [run(channels, value + constant, f"r{constant}") for constant in (0, 3)]
    shaped = model.shaped(runs)
    assert shaped.terms[2].shape == {"time_constant": nearest}
    assert shaped.shaped(runs) == shaped


def _shapes(name: str, of: RunBlocks) -> list[dict[str, float]]:
    from analytics.loop.effects.registry import effect

    return [{key: float(str(value)) for key, value in shape.items()} for shape in effect(name).shapes([of])]


@pytest.mark.parametrize(
    "document",
    [
        "{}",
        '{"terms": 3}',
        '{"terms": [{"name": "bias"}], "coefficients": [1.0], "covariance": [[1.0, 2.0]]}',
        '{"terms": [{"name": "bias"}, {"name": "bias"}]}',
        '{"terms": [{"name": "no_such_effect"}]}',
        '{"terms": [{"name": "bias"}], "coefficients": [1.0], "units": ["deg/h", "deg/h"]}',
    ],
)
def test_a_document_that_is_no_model_is_refused(document: str) -> None:
    with pytest.raises(BadInput):
        ErrorModel.from_json(document)


def test_the_whitened_residual_is_that_of_the_dense_covariance(cycled: RunBlocks) -> None:
    rng = np.random.default_rng(9)
    noise = ModelNoise(N=0.2, B=1.0, K=2.0, turn_on=3.0)
    kept = np.sort(rng.choice(BLOCKS, 150, replace=False))
    white = rng.uniform(0.5, 2.0, 150)
    channels = {
        name: Channel(each.mean[kept], each.spread[kept], each.unit_of_measure)
        for name, each in cycled.channels.items()
    }
    gappy = replace(
        cycled, slot=kept, value=rng.normal(0.0, 1.0, 150), n=np.full(150, 9), white_variance=white, channels=channels
    )
    fitted = ErrorModel.parse("bias + temperature").fitted([1.0, 0.1])
    model = NoiseModel(30.0, float(kept[-1] + 1 - kept[0]) * 30.0)
    covariance = model.covariance(noise, kept.astype(np.float64), white / model.space(noise).white)
    expected = np.linalg.solve(np.linalg.cholesky(covariance), fitted.residual(gappy))
    np.testing.assert_allclose(whitened_residual(fitted, gappy, noise), expected, rtol=1e-8, atol=1e-10)
