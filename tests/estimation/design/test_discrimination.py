"""T-optimality: stops added one by one give the non-centrality of the refit with all of them."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.design.information import Discrimination, SequentialDesign, joint_gains

pytestmark = pytest.mark.fast


def a_discrimination(seed: int, p: int = 6, d: int = 40, m: int = 15) -> Discrimination:
    rng = np.random.default_rng(seed)
    return Discrimination(
        run_columns=rng.normal(size=(p, d)) * np.geomspace(1.0, 1e4, p)[:, None],
        precision=np.array([0.0, 0.0, 0.0, 0.0, 2.0, 0.0]),
        run_signals=rng.normal(size=(1, d)),
        candidate_columns=rng.normal(size=(p, m, 3)) * np.geomspace(1.0, 1e4, p)[:, None, None],
        candidate_signals=rng.normal(size=(1, m, 3)),
    )


def test_stops_added_one_by_one_are_the_refit_with_all_of_them() -> None:
    one = a_discrimination(0)
    design = one.start_design()
    added: list[int] = []
    for stop in (3, 7, 3, 14):
        promised = design.noncentrality + design.gains()[stop]
        design.add(stop)
        added.append(stop)
        columns = (one.candidate_columns[:, k] for k in added)
        rows = np.hstack([one.run_columns, *columns, np.diag(np.sqrt(one.precision))])
        signals = (one.candidate_signals[0, k] for k in added)
        signal = np.concatenate([one.run_signals[0], *signals, np.zeros(len(rows))])
        fitted = np.linalg.lstsq(rows.T, signal, rcond=None)[0]
        truth = float(np.sum((signal - fitted @ rows) ** 2))
        assert promised == pytest.approx(truth, rel=1e-8)
        assert design.noncentrality == pytest.approx(truth, rel=1e-8)
        assert one.noncentrality(np.array(added)) == pytest.approx(truth, rel=1e-8)


def a_design(noncentrality: float, errors: list[float]) -> SequentialDesign:
    m = len(errors)
    error = np.zeros((1, m, 3))
    error[0, :, 0] = errors
    return SequentialDesign(np.zeros((m, 3, 1)), np.eye(1), np.zeros((m, 3, 3)), error, noncentrality)


def test_the_comparison_that_is_furthest_from_its_need_leads() -> None:
    ahead, behind = a_design(9.0, [1.0, 0.0]), a_design(1.0, [0.0, 0.8])
    gains = joint_gains([ahead, behind], [10.0, 10.0], 5)
    assert gains.max() == 1.0
    assert int(np.argmax(gains)) == 1


def test_a_hopeless_comparison_is_left_aside() -> None:
    reachable, hopeless = a_design(5.0, [1.0, 0.0]), a_design(0.0, [0.0, 1e-3])
    gains = joint_gains([reachable, hopeless], [10.0, 10.0], 5)
    assert int(np.argmax(gains)) == 0
    alone = joint_gains([hopeless], [10.0], 5)
    assert int(np.argmax(alone)) == 1, "unless there is no other"
