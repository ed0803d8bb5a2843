"""Speed, as ratios of processor times of one run: nothing absolute is asserted. Bounds are far above what is measured,
so that only a real loss trips them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import clear_stops, refuse_motion, refuse_stop
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.estimation.design.block_design import BlockDesign, Candidates, Criterion, reference_errors
from cellapp.robot.kinematics.chain import JointAngles, jacobian, smr_positions
from tests.arms import OFF_AXIS, UR10, at_station, true_geometry
from tests.latency import attempts
from tests.twin import PROFILES

pytestmark = pytest.mark.slow
NOISE_M, COLUMNS, STOPS = 15e-6, 150, 400
REAL = load_profile(PROFILES / "ur10-ur5.yaml")
"""The real cell: a table, two pedestals and a pillar."""


@pytest.fixture(autouse=True)
def _one_blas_thread():
    """Small problems gain nothing from more, and ratios stay ratios."""
    with threadpool_limits(limits=1):
        yield


def best_of(repeats: int, *functions: Callable[[], object]) -> np.ndarray:
    """Smallest processor time of each function, called in turns so that all meet the same machine."""
    times = np.empty((repeats, len(functions)))
    for row in times:
        for k, function in enumerate(functions):
            began = time.process_time()
            function()
            row[k] = time.process_time() - began
    return np.asarray(times.min(axis=0))


def problem(n: int):
    """Where an identification starts, joint positions (n, 6) [rad] and measured points (n, 3) [m]."""
    rng = np.random.default_rng(0)
    nominal = at_station(UR10, OFF_AXIS)
    truth = true_geometry(nominal, rng)
    q = rng.uniform(-3, 3, (n, 6))
    p_M = smr_positions(truth, q) + rng.normal(0.0, NOISE_M, (n, 3))
    return start_from_nominal(nominal, q, p_M, tool_unknown=False), q, p_M


def test_identification_of_27_parameters_is_near_its_floor() -> None:
    start, q, p_M = problem(400)
    found = identify(start, q, p_M)
    assert (len(found.names), found.iterations) == (27, 3)

    def floor() -> None:
        """What three iterations cannot do without: a Jacobian and a normal matrix each."""
        for _ in range(found.iterations):
            _, J = jacobian(start, JointAngles.of(q), found.parameter_set.columns)
            rows = J.transpose(0, 2, 1).reshape(-1, len(found.parameter_set.columns))
            rows.T @ rows

    ours, least = best_of(200, lambda: identify(start, q, p_M), floor)
    assert ours / least < 3.5


def test_cost_per_configuration_does_not_grow() -> None:
    small, large = problem(4_000), problem(400_000)
    for one in attempts(ratio=1.5):  # what else runs takes the memory's time from the large problem alone
        few = best_of(10, lambda: identify(*small))[0] / 4_000
        one["ratio"] = best_of(3, lambda: identify(*large))[0] / 400_000 / few


def test_an_update_of_rank_three_against_fresh_products() -> None:
    rng = np.random.default_rng(0)
    candidates = Candidates(rng.normal(size=(1000, 3, COLUMNS)) * rng.uniform(0.2, 2.0, (1000, 1, 1)), np.eye(COLUMNS))
    reference = reference_errors(candidates.mean_information, STOPS, candidates.prior, COLUMNS)
    chosen = np.arange(STOPS)
    criterion = Criterion(reference, rng.normal(size=(600, 3, COLUMNS)))
    weights = criterion.weights(candidates.covariance(chosen))
    design = BlockDesign(candidates.information(chosen), weights)
    design.track(candidates.rows)

    def update() -> None:
        design.change(candidates.rows[0], -1.0)
        design.change(candidates.rows[0])

    updates, products = best_of(
        20, update, lambda: BlockDesign(candidates.information(chosen), weights).track(candidates.rows)
    )
    assert updates / 2.0 < 0.4 * products


def drawn(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    ranges = {name: np.array(arm.limits) for name, arm in REAL.arms.items()}
    return {name: rng.uniform(one[:, 0], one[:, 1], (count, 6)) for name, one in ranges.items()}


def test_obstacles_cost_little_and_many_stops_at_once_less_than_one_by_one() -> None:
    cell, bare = cell_bodies(REAL), cell_bodies(REAL.model_copy(update={"obstacles": {}}))
    home, q = home_positions(REAL), drawn(20_000)
    free = np.flatnonzero(clear_stops(cell, q))[:400]
    ways = [(home, {name: value[k] for name, value in q.items()}) for k in free]
    ways = [way for way in ways if not refuse_motion(cell, *way)][:40]
    assert len(ways) > 20
    ours, without = best_of(
        9, lambda: [refuse_motion(cell, *way) for way in ways], lambda: [refuse_motion(bare, *way) for way in ways]
    )
    assert ours / without < 3.0
    few = [{name: value[k] for name, value in q.items()} for k in range(200)]
    assert clear_stops(cell, q)[:200].tolist() == [not refuse_stop(cell, one) for one in few]
    together, one_by_one = best_of(3, lambda: clear_stops(cell, q), lambda: [refuse_stop(cell, one) for one in few])
    assert one_by_one / len(few) > 10.0 * together / 20_000
