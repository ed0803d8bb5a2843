"""The table of kinds of readings, with few stops and without effects."""

from __future__ import annotations

import numpy as np

from tests.trials.kinds import Bench, lines, simulated


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
