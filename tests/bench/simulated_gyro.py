"""Rate of a simulated gyro with planted effects: million samples a second of processor time, by effect, and by hold.

.venv/bin/python tests/bench/simulated_gyro.py [--samples 2000000] [--block 2000]
"""

import argparse
import time

import numpy as np

from ingest.simulator.physics.mounting import TableEnvironment
from ingest.simulator.physics.plan import Plan, parse_plan
from stream.batch import FloatArray, IntArray

TYPICAL = {
    "nothing": "",
    "scale": """
[fleet.scale]
error_ppm = 120.0
nonlinearity_ppm = [3.0, -8.0]
asymmetry_ppm = 4.0
temperature_ppm_per_deg_c = 12.0""",
    "bias": """
[fleet.bias]
constant_deg_per_h = {mean = 0.0, sd = 0.5}
turn_on_deg_per_h = 0.05
warm_up = [{amplitude_deg_per_h = 0.3, time_constant_s = 400.0}]
acceleration_deg_per_h_per_g = [0.05, 0.02, 0.02]
jumps = {rate_per_h = 0.1, sd_deg_per_h = 0.1}""",
    "thermal": """
[fleet.thermal]
lag_s = 120.0
bias_polynomial_deg_per_h = [0.03, 0.001]
rate = {deg_per_h_per_deg_c_per_min = 0.4}
hysteresis = [{half_loop_deg_per_h = 0.05, width_deg_c = 4.0}]""",
    "noise": """
[fleet.noise]
angle_quantum_arcsec = 0.01
angle_random_walk_deg_per_sqrt_h = 0.02
bias_instability_deg_per_h = 0.05
rate_random_walk_deg_per_h_per_sqrt_h = 0.03
markov = [{sd_deg_per_h = 0.1, correlation_s = 300.0}]""",
    "misalignment": """
[fleet.misalignment]
y_arcsec = 40.0
z_arcsec = -25.0""",
    "dynamics": """
[fleet.dynamics]
bandwidth_hz = 40.0
delay_s = 0.0023""",
    "readout": """
[fleet.readout]
saturation_deg_per_s = 500.0
dropout = {probability = 1e-6, mean_samples = 3.0}""",
}
HEAD = '[fleet]\nseed = 7\nunits = ["FOG-0231"]\n'


def table_rate(t_ns: IntArray) -> FloatArray:
    return np.full(len(t_ns), 10.0)


def table_angle(t_ns: IntArray) -> FloatArray:
    return np.asarray(t_ns * 1e-8, np.float64)


def temperature(t_ns: IntArray) -> FloatArray:
    return np.asarray(25.0 + t_ns * (1e-9 / 60), np.float64)


def million_per_s(plan: Plan, samples: int, block: int) -> float:
    environment = TableEnvironment(
        45.0, "input_up", rate_deg_per_s=table_rate, angle_deg=table_angle, temperature_deg_c=temperature
    )
    plan.gyro("FOG-0231", environment=environment).samples(block)  # compiles
    gyro = plan.gyro("FOG-0231", environment=environment)
    began = time.process_time()
    for _ in range(0, samples, block):
        gyro.samples(block)
    return samples / (time.process_time() - began) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2_000_000)
    parser.add_argument("--block", type=int, default=2000)
    arguments = parser.parse_args()
    everything = "".join(TYPICAL.values())
    plans = {name: HEAD + text for name, text in TYPICAL.items()} | {"all": HEAD + everything}
    plans["all, hold 0.1 s"] = f"{HEAD}hold_s = 0.1\n{everything}"
    for name, text in plans.items():
        rates = [million_per_s(parse_plan(text, name), arguments.samples, arguments.block) for _ in range(3)]
        print(f"{name:18}{max(rates):8.2f} million samples/s")


if __name__ == "__main__":
    main()
