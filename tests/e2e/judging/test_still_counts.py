"""Outputs in counts that stand still: no pass, also where the resolution alone could keep them there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from tests.ingest.can.test_power_cycles import DBC, MAPPING

Ask = Callable[..., Any]
LIMITS = """
revision = "A"
[product.P]
[[limit]]
metric = "bias"
lower = -60.0
upper = 60.0
unit_of_measure = "deg/h"
"""
N = 6000


def records() -> dict[str, np.ndarray]:
    """Counts of 1e-3 deg/s: frozen, frozen for nine tenths, of a resolution that shows little noise, and sound."""
    rng = np.random.default_rng(8)
    noisy = np.rint(3 + 2 * rng.standard_normal(N)).astype(int)
    partly = noisy.copy()
    partly[600:] = 3
    return {
        "frozen": np.full(N, 3),
        "partly": partly,
        "coarse": np.rint(3.3 + 0.3 * rng.standard_normal(N)).astype(int),
        "sound": noisy,
    }


@pytest.mark.parametrize(
    ("name", "verdict", "words"),
    [
        ("frozen", "MARGINAL", "all 6000 samples are alike"),
        ("partly", "MARGINAL", "5400 of 6000 samples in a row are alike"),
        ("coarse", "PASS", None),
        ("sound", "PASS", None),
    ],
)
@pytest.mark.in_gate("partly-MARGINAL-5400 of 6000 samples in a row are alike")
def test_an_output_in_counts_that_stood_still_does_not_pass(
    ask: Ask, tmp_path: Path, name: str, verdict: str, words: str | None
) -> None:
    (tmp_path / "gyro.dbc").write_text(DBC)
    (tmp_path / "map.toml").write_text(MAPPING)
    (tmp_path / "limits.toml").write_text(LIMITS)
    with can.Logger(tmp_path / "bench.blf") as logger:
        for i, value in enumerate(records()[name].tolist()):
            body = value.to_bytes(4, "little", signed=True) + i.to_bytes(2, "little")
            logger.on_message_received(
                can.Message(timestamp=1.7e9 + i * 0.02, arbitration_id=0x100, is_extended_id=False, data=body)
            )
    ask(
        "import", tmp_path / "bench.blf", "--dbc", tmp_path / "gyro.dbc", "--mapping", tmp_path / "map.toml",
        "--procedure", "static_bias", "--position", "IRA_up", "--latitude", "39.9",
    )  # fmt: skip
    ask("limits", "add", tmp_path / "limits.toml")
    rows = [row for row in ask("verdicts")["verdicts"] if row["metric"] == "bias"]
    assert {row["verdict"] for row in rows} == {verdict}, rows
    if words is not None:
        assert all(words in row["reason"] for row in rows), rows
