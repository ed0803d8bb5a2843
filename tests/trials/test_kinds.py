"""The table of kinds of readings, with few stops and without effects."""

from __future__ import annotations

import numpy as np

from tests.trials.kinds import MADE_NOISE_M, PROBE, Bench, lines, simulated, smrs_of_poses


def test_orientation_is_better_with_a_probe() -> None:
    found = dict(simulated(2, 48, discover=False))
    assert list(found) == ["one SMR", "6-D probe", "three SMRs"]
    for kind in ("6-D probe", "three SMRs"):
        assert found[kind].orientation_mrad < found["one SMR"].orientation_mrad
    assert all(np.isfinite(one.smr_mm) for one in found.values())
    table = list(lines({kind: [one] for kind, one in found.items()}))
    assert table[1].startswith("one SMR | ")


def test_the_truth_is_that_of_the_simulated_arm() -> None:
    bench = Bench(1, 40)
    truth = bench.truth()
    np.testing.assert_allclose(
        truth.R_M_F @ truth.R_M_F.swapaxes(1, 2), np.tile(np.eye(3), (len(truth.q), 1, 1)), atol=1e-12
    )


def test_three_smrs_made_from_poses_stand_as_the_pose_says() -> None:
    bench = Bench(1, 40)
    measured = bench.measured(bench.profile(probe=PROBE))
    made = smrs_of_poses(measured, np.random.default_rng(1))
    assert made.smr is not None
    at = {name: made.p_M[[one == name for one in made.smr]] for name in "ABC"}
    np.testing.assert_array_equal(at["A"], measured.p_M)
    for name in "BC":
        apart_m = np.linalg.norm(at[name] - at["A"], axis=1)
        assert np.abs(apart_m - 0.1).max() < 6.0 * MADE_NOISE_M
