"""The table of kinds of readings, with few stops and without effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellapp.cell.profile import load_profile
from tests.trials.kinds import NEST_NOISE_M, PROBE, Bench, led_arms, lines, nests_of_poses, simulated
from tests.twin import PROFILES


def test_orientation_is_better_with_a_probe_and_ten_touches_find_a_changed_zero() -> None:
    found = dict(simulated(2, 48, discover=False))
    assert list(found) == [
        "one SMR",
        "three SMRs",
        "6-D probe",
        "sockets only",
        "earlier calibration, joint 3 changed",
        "the same after ten touches of a socket",
    ]
    assert found["6-D probe"].orientation_mrad < found["one SMR"].orientation_mrad
    assert all(np.isfinite(one.smr_mm) for one in found.values())
    table = list(lines({kind: [one] for kind, one in found.items()}))
    assert table[1].startswith("one SMR | ")


def test_the_truth_is_that_of_the_simulated_arm() -> None:
    bench = Bench(1, 40)
    truth = bench.truth()
    np.testing.assert_allclose(
        truth.R_M_F @ truth.R_M_F.swapaxes(1, 2), np.tile(np.eye(3), (len(truth.q), 1, 1)), atol=1e-12
    )
    moved = bench.truth(1e-3)
    assert 1e-4 < np.linalg.norm(moved.p_M - truth.p_M, axis=1).mean() < 1e-2


def test_three_nests_made_from_poses_stand_as_the_pose_says() -> None:
    bench = Bench(1, 40)
    measured = bench.measured(bench.profile(probe=PROBE))
    made = nests_of_poses(measured, np.random.default_rng(1))
    assert made.smr is not None
    at = {name: made.p_M[[one == name for one in made.smr]] for name in "ABC"}
    np.testing.assert_array_equal(at["A"], measured.p_M)
    for name in "BC":
        apart_m = np.linalg.norm(at[name] - at["A"], axis=1)
        assert np.abs(apart_m - 0.1).max() < 6.0 * NEST_NOISE_M


def test_real_arms_in_sockets_are_judged_at_held_out_placements(tmp_path: Path) -> None:
    data = Path(__file__).parents[1] / "fixtures" / "panda-sockets"
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_bytes((data / "readings.csv").read_bytes())
        (tmp_path / f"{name}-distances.csv").write_bytes((data / "distances.csv").read_bytes())
    found = dict(led_arms(load_profile(PROFILES / "panda-sockets.yaml"), tmp_path, discover=False))
    assert list(found) == ["sockets only, one", "sockets only, two", "two after a calibration of one"]
    assert 0.3 < found["sockets only, one"].smr_mm < 1.5
    assert found["two after a calibration of one"].smr_mm < 1.5 * found["sockets only, one"].smr_mm
