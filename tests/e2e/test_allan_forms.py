"""`gyrofleet allan` with every deviation and overlap, and over a rolling window, from a file to JSON and plot."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import allantools
import numpy as np
import polars as pl
import pytest

from stream.batch import FloatArray

RATE_HZ = 50.0
N = 90_000


def rate_deg_per_h() -> FloatArray:
    """Half an hour, three times as noisy in its last third."""
    rng = np.random.default_rng(952)
    noise = rng.standard_normal(N)
    noise[2 * N // 3 :] *= 3.0
    values: FloatArray = 15.0 + noise + np.cumsum(rng.standard_normal(N)) * 1e-3
    return values


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    folder = tmp_path_factory.mktemp("forms")
    table = pl.DataFrame({"time[s]": np.arange(N) / RATE_HZ, "rate[deg/h]": rate_deg_per_h()})
    table.write_parquet(folder / "half-hour.parquet")
    file = folder / "half-hour.parquet"
    assert run_command("import", file, "--unit", "FOG-1", "--store", folder / "store", cwd=folder).code == 0
    return folder / "store"


def ask(store: Path, *more: object) -> tuple[object, ...]:
    return ("allan", "--unit", "FOG-1", "--signal", "rate", "--store", store, *more)


@pytest.mark.parametrize("kind", ["adev", "oadev", "mdev", "hdev", "ohdev"])
@pytest.mark.in_gate("mdev", "ohdev")
def test_every_deviation_agrees_with_allantools(gyrofleet: Callable[..., Any], store: Path, kind: str) -> None:
    found = gyrofleet(*ask(store, "--deviation", kind, "--points-per-octave", 2, "--json")).json
    assert (found["deviation"], found["overlap"]) == (kind, "full")
    column = found["value"]
    taus_s = np.array(found["tau_s"])
    peer = getattr(allantools, kind)(rate_deg_per_h(), rate=RATE_HZ, data_type="freq", taus=taus_s)
    by_tau = dict(zip(np.round(peer[0], 9).tolist(), peer[1].tolist(), strict=True))
    compared = [(value, by_tau[round(t, 9)]) for t, value in zip(taus_s, column, strict=True) if round(t, 9) in by_tau]
    assert len(compared) >= 25
    ours, theirs = np.array(compared).T
    np.testing.assert_allclose(ours, theirs, rtol=1e-8)  # the peer sums with the mean of 15 sigma
    assert all(lo <= y <= hi for lo, y, hi in zip(found["lo"], column, found["hi"], strict=True))
    assert len(found["edf"]) == len(column)


@pytest.mark.long
def test_the_form_that_runs_while_data_flow_is_close_to_the_full_one(
    gyrofleet: Callable[..., Any], store: Path
) -> None:
    full = gyrofleet(*ask(store, "--json")).json
    strided = gyrofleet(*ask(store, "--overlap", "strided", "--json")).json
    assert (full["overlap"], strided["overlap"]) == ("full", "strided")
    assert full["tau_s"] == strided["tau_s"]
    for tau_s, a, b, edf in zip(full["tau_s"], full["value"], strided["value"], full["edf"], strict=True):
        # up to 16 intervals the same; beyond, another choice among overlapping windows, far within the uncertainty
        assert b == pytest.approx(a, rel=1e-12 if tau_s <= 16 / RATE_HZ else 0.25 / np.sqrt(2 * edf))


@pytest.mark.long
def test_given_averaging_times_have_the_values_of_the_whole_curve(gyrofleet: Callable[..., Any], store: Path) -> None:
    whole = gyrofleet(*ask(store, "--deviation", "mdev", "--json")).json
    some = gyrofleet(*ask(store, "--deviation", "mdev", "--tau", "0.64,10,100", "--json")).json
    assert some["tau_s"] == pytest.approx([0.64, 10.0, 100.0])
    assert some["value"][0] == whole["value"][whole["tau_s"].index(0.64)]
    assert list(some) == list(whole) == list(gyrofleet(*ask(store, "--json")).json)


def test_averaging_times_that_the_record_cannot_give_are_named(gyrofleet: Callable[..., Any], store: Path) -> None:
    """Half an hour at 50 Hz has two averages of 900 s, and none of 1000 s."""
    some = gyrofleet(*ask(store, "--tau", "1000,10,2000", "--json"))
    assert some.json["tau_s"] == pytest.approx([10.0])
    assert some.json["left_out_tau_s"] == [1000.0, 2000.0]
    shown = gyrofleet(*ask(store, "--tau", "1000,10,2000"))
    assert "no deviation at 1000 s, 2000 s: this record reaches 900 s" in " ".join(shown.out.split())
    alone = gyrofleet(*ask(store, "--tau", "5000"))
    assert alone.code != 0
    assert "no averaging time of this record is longer than 900 s" in " ".join(alone.err.split())


@pytest.mark.long
def test_a_rolling_window_shows_when_the_noise_rose(gyrofleet: Callable[..., Any], store: Path, tmp_path: Path) -> None:
    done = gyrofleet(*ask(store, "--rolling", 0.1, "--step", 0.05, "--plot", "rolling.png", "--json"))
    surface = done.json
    assert (tmp_path / "rolling.png").read_bytes().startswith(b"\x89PNG")
    assert surface["start_h"] == pytest.approx([0.05 * i for i in range(9)])
    assert len(surface["adev"]) == len(surface["lo"]) == len(surface["hi"]) == 9
    assert all(len(row) == len(surface["tau_s"]) for row in surface["adev"])
    first = [row[0] for row in surface["adev"]]
    # windows before 20 min hold white noise of 1 deg/h a sample, those after it 3 deg/h: 17,999 differences each
    np.testing.assert_allclose(first[:5], 1.0, rtol=5 / np.sqrt(17_999))
    np.testing.assert_allclose(first[7:], 3.0, rtol=5 / np.sqrt(17_999))
    table = gyrofleet(*ask(store, "--rolling", 0.1))
    assert "limits" in table.out.split("deviations in")[1]
    assert "Rolling Allan deviation (动态 Allan 标准差) of FOG-1 rate" in table.out
    assert "33 windows of 0.1 h every 0.0125 h" in table.out
    assert table.code == 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--deviation", "mdev", "--overlap", "strided"), "mdev has no strided form"),
        (("--deviation", "ohdev", "--fit"), "are of the overlapping Allan deviation"),
        (("--step", "1"), "give --rolling HOURS as well"),
        (("--rolling", "0.1", "--fit"), "--rolling goes with"),
        (("--rolling", "0.1", "--step", "0.03"), "it takes a whole number of steps"),
        (("--tau", "10,x"), "averaging times in seconds are expected"),
        (("--tau", "0.03"), "a whole number of sample intervals"),
        (("--tau", "10", "--overlap", "strided"), "given averaging times need every window"),
        (("--rolling", "0.1", "--tau", "10"), "--rolling goes with"),
        (("--rolling", "0"), "it takes a whole number of steps"),
        (("--rolling", "9"), "the record has 1799.98 s; give a shorter --rolling"),
    ],
)
def test_what_does_not_go_together_is_refused(
    gyrofleet: Callable[..., Any], store: Path, options: tuple[str, ...], why: str
) -> None:
    done = gyrofleet(*ask(store, *options))
    assert done.code != 0
    assert why in done.err
