"""Signals for a picture: every sample is in its bucket at every zoom, gaps stay gaps."""

import io
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.analytics.serve.served_store import GAP, RATE_HZ, SPIKE, SPIKE_AT, START_NS, STEP_S, STEPS, rates

DT_NS = 10**9 // RATE_HZ
N = RATE_HZ * STEP_S * STEPS
SPIKE_NS = START_NS + SPIKE_AT * DT_NS
SPIKED = "/api/signals/FOG-0001/run-1/rate"


def asked(api: httpx.Client, path: str = SPIKED, /, **parameters: Any) -> dict[str, Any]:
    answer = api.get(path, params=parameters)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.mark.long
@pytest.mark.parametrize("points", [2, 3, 10, 100, 601, 1000, 5000, 10_000])
def test_the_spike_is_there_with_any_number_of_points(api: httpx.Client, points: int) -> None:
    found = asked(api, points=points)
    assert len(found["t_ns"]) <= points
    at = int(np.argmax(found["max"]))
    assert found["max"][at] == SPIKE
    assert found["t_ns"][at] <= SPIKE_NS < found["t_ns"][at] + max(found["bucket_ns"], 1)
    assert sum(found["n"]) == N


@pytest.mark.parametrize("width_s", [600, 90, 20, 5, 1, 0.1, 0.02])
def test_the_spike_is_there_at_any_zoom_around_it(api: httpx.Client, width_s: float) -> None:
    half = round(width_s * 5e8)
    found = asked(api, points=50, **{"from": SPIKE_NS - half, "to": SPIKE_NS + half})
    assert max(found["max"]) == SPIKE
    assert found["source"] in ("rollup_10s", "rollup_1s", "raw", "samples")


def test_close_enough_each_sample_stands_alone(api: httpx.Client) -> None:
    found = asked(api, points=20, **{"from": SPIKE_NS - 2 * DT_NS, "to": SPIKE_NS + 3 * DT_NS})
    assert (found["source"], found["bucket_ns"], found["n"]) == ("samples", 0, [1] * 5)
    assert found["t_ns"] == [SPIKE_NS + at * DT_NS for at in range(-2, 3)]
    assert found["min"] == found["max"] == found["mean"] == list(rates(1, 1)[SPIKE_AT - 2 : SPIKE_AT + 3])


@pytest.mark.long
@given(first=st.integers(-10, N), length=st.integers(1, N), points=st.integers(2, 400))
@settings(max_examples=12)
def test_buckets_are_those_of_the_samples(api: httpx.Client, first: int, length: int, points: int) -> None:
    from_ns, to_ns = START_NS + first * DT_NS, START_NS + (first + length) * DT_NS
    found = asked(api, points=points, **{"from": from_ns, "to": to_ns})
    values, t_ns = rates(1, 1), START_NS + np.arange(N) * DT_NS
    assert len(found["t_ns"]) <= points
    width = max(found["bucket_ns"], 1)
    for at, begin in enumerate(found["t_ns"]):
        # buckets of rollups are whole, others end with the stretch
        first_ns, stop_ns = max(begin, found["covers_from_ns"]), min(begin + width, found["covers_to_ns"])
        inside = values[(t_ns >= first_ns) & (t_ns < stop_ns)]
        assert found["n"][at] == inside.size
        assert (found["min"][at], found["max"][at]) == (inside.min(), inside.max())
        assert found["mean"][at] == pytest.approx(inside.mean(), rel=1e-9, abs=1e-12)
    assert found["covers_from_ns"] <= from_ns or found["covers_from_ns"] <= START_NS
    assert found["covers_to_ns"] >= min(to_ns, START_NS + N * DT_NS)
    # nothing of the stretch is left out
    edges = np.array(found["t_ns"], np.int64)
    for at in np.flatnonzero((t_ns >= from_ns) & (t_ns < to_ns))[[0, -1]] if edges.size else []:
        assert ((edges <= t_ns[at]) & (t_ns[at] < edges + width)).any()


@pytest.mark.parametrize("points", [10_000, 500, 25])
def test_a_gap_stays_a_gap_and_has_its_ends_at_any_width(api: httpx.Client, points: int) -> None:
    found = asked(api, "/api/signals/FOG-0002/run-1/rate", points=points)
    ((begin, end),) = found["gaps"]
    assert (begin, end) == (START_NS + (GAP[0] - 1) * DT_NS, START_NS + GAP[1] * DT_NS)
    assert not any(begin < t_ns < end - found["bucket_ns"] for t_ns in found["t_ns"])
    assert sum(found["n"]) == N - (GAP[1] - GAP[0])


def test_a_stretch_without_samples_is_empty_and_no_error(api: httpx.Client) -> None:
    found = asked(api, **{"from": "2020-01-01T00:00:00Z", "to": "2020-01-02T00:00:00+08:00"})
    assert (found["t_ns"], found["samples"], found["gaps"]) == ([], 0, [])


def test_arrow_and_csv_have_the_same_columns(api: httpx.Client) -> None:
    found = asked(api, points=30)
    answer = api.get(SPIKED, params={"points": 30}, headers={"Accept": "application/vnd.apache.arrow.stream"})
    assert answer.headers["content-type"] == "application/vnd.apache.arrow.stream"
    table = pa.ipc.open_stream(io.BytesIO(answer.content)).read_all()
    assert table.schema.field("t_ns").type == pa.int64()
    for name in ("t_ns", "min", "max", "mean", "n"):
        assert table[name].to_pylist() == found[name]
    lines = api.get(SPIKED, params={"points": 30, "format": "csv"}).text.splitlines()
    assert lines[0] == "time,t_ns,min,max,mean,n"
    assert len(lines) == len(found["t_ns"]) + 1


@pytest.mark.parametrize("offset_s", [0.013, 0.5, 3.3])
@pytest.mark.parametrize("width_s", [0.5, 7.77, 41.3])
@pytest.mark.parametrize("points", [3, 100])
def test_a_stretch_has_its_own_samples_only(api: httpx.Client, offset_s: float, width_s: float, points: int) -> None:
    """One that begins just behind the spike does not have it; buckets of rollups say how far they reach."""
    first = SPIKE_NS + round(offset_s * 1e9)
    stop = first + round(width_s * 1e9)
    found = asked(api, points=points, **{"from": first, "to": stop})
    t_ns = START_NS + np.arange(N) * DT_NS
    covered = (t_ns >= found["covers_from_ns"]) & (t_ns < found["covers_to_ns"])
    values = rates(1, 1)[covered]
    assert found["samples"] == covered.sum()
    assert (min(found["min"]), max(found["max"])) == (values.min(), values.max())
    assert found["covers_from_ns"] <= first
    assert found["covers_to_ns"] >= stop
    if not found["source"].startswith("rollup"):
        assert (found["covers_from_ns"], found["covers_to_ns"]) == (first, stop)
        assert max(found["max"]) < SPIKE


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"from": "yesterday"}, "from"),
        ({"from": "2026-11-21T10:00:00"}, "time zone"),
        ({"from": "20", "to": "10"}, "the stretch ends (10) before it begins (20)"),
        ({"points": "1"}, "points"),
        ({"points": "1000000"}, "points"),
        ({"point": "10"}, "point"),
        ({"format": "xml"}, "format"),
        ({"from": str(10**30)}, "from"),
    ],
)
def test_a_wrong_parameter_is_named(api: httpx.Client, parameters: dict[str, str], word: str) -> None:
    answer = api.get(SPIKED, params=parameters)
    assert answer.status_code == 400
    assert word in answer.json()["error"]["message"]


@pytest.mark.parametrize(
    ("path", "there"),
    [("FOG-9999/run-1/rate", "FOG-0001"), ("FOG-0001/run-9/rate", "run-1"), ("FOG-0001/run-1/tilt", "temperature")],
)
def test_what_is_not_there_is_answered_with_what_is(api: httpx.Client, path: str, there: str) -> None:
    answer = api.get(f"/api/signals/{path}")
    assert answer.status_code == 404
    assert there in answer.json()["error"]["message"]
