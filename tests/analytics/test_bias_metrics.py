import numpy as np
from scipy import stats
START_NS = 1_763_683_200 * 10**9
from stream.estimators.random_walk_normalised import angle_random_walk_normalised
def test_averaged(tested):
    rng = np.random.default_rng(1)
    values = rng.normal(5, 3, 14400) + np.cumsum(rng.normal(0, 0.02, 14400))
    tested.run("r1", procedure="static_bias")
    e=tested.step("r1", "U1", values, t0_ns=START_NS, dt_ns=25*10**7,procedure="static_bias")
    v=rng.normal(5, 3, 12000)
    tested.run("r2", procedure="random_walk")
    tested.step("r2", "U1", v, t0_ns=e, dt_ns=5*10**6,procedure="random_walk")
    rows = tested.metric("angle_random_walk")
    for r in rows: print(r)
    print(3*np.sqrt(.25)/60, angle_random_walk_normalised(v,0.005).coefficient)
    for r in tested.metric("bias_instability"): print(r)
