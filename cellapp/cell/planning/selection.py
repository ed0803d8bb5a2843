"""Selection of the most informative stops of each arm from its pool of candidates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellapp.cell.planning.candidates import CandidatePool
from cellapp.cell.planning.each_arm import of_each_arm
from cellapp.cell.planning.information import even_conditions, information_model
from cellapp.cell.planning.workspace import workspace_configurations
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.estimation.design.block_choice import Candidates, choose_blocks, most_informative_first
from cellapp.estimation.design.block_design import Criterion, Rows, information_of, reference_errors
from cellapp.estimation.design.gaps import close_gaps, gap_limits, without_turns
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.kinematics.transforms import Array

_POINTS = 600
"""Configurations that represent the workspace: the mean is then known to 2 %, the worst point to a few percent."""


def select_stops(
    profile: Profile,
    pools: Mapping[str, CandidatePool],
    count: int,
    rng: np.random.Generator,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    kept: Mapping[str, Array] | None = None,
) -> dict[str, Rows]:
    """Choose ``count`` candidates of each arm, fewer where its pool has fewer; the most informative first.

    Each arm has its own thread and its own stream of random numbers, spawned from ``rng``: the result does not depend
    on which is faster. ``kept`` are configurations (k, N) [rad] of each arm that are in the plan already: their
    information counts before the first choice, and they count in the coverage of the joints.

    Raises
    ------
    InputError
        If the profile lists an effect that no plan of this cell can show, or does not describe the cell.
    Cancelled
    """
    cancel = cancel or CancelToken()
    q = {name: pool.q for name, pool in pools.items()}

    def choose(name: str, own_rng: np.random.Generator) -> Rows:
        return _select(profile, name, q, count, None if kept is None else kept.get(name), own_rng, cancel)

    listener(Progress("select", 0, len(pools), " and ".join(f"arm {name}" for name in pools)))
    chosen = of_each_arm(choose, pools, rng)
    listener(Progress("select", len(pools), len(pools), "done"))
    return chosen


def _select(
    profile: Profile,
    name: str,
    pools: Mapping[str, Array],
    count: int,
    kept: Array | None,
    rng: np.random.Generator,
    cancel: CancelToken,
) -> Rows:
    """Choose candidates of one arm; ``pools`` are the configurations of all arms."""
    q, others = pools[name], {other: q for other, q in pools.items() if other != name}
    if not count or not len(q):
        return np.arange(0)
    conditions = even_conditions(profile, name, q, others, rng)
    model = information_model(profile, name, q, conditions)
    kept = np.empty((0, q.shape[1])) if kept is None else kept
    before = model.rows(kept, even_conditions(profile, name, kept, others, rng))
    candidates = Candidates(model.rows(q, conditions, np.float32), np.eye(len(model.size)) + information_of(before))
    targets = workspace_configurations(profile, cell_bodies(profile), name, _POINTS, rng)
    criterion = Criterion(
        reference_errors(candidates.mean_information, count, candidates.prior, model.wanted),
        model.prediction_rows(targets, even_conditions(profile, name, targets, others, rng)),
    )
    chosen = choose_blocks(candidates, count, criterion, rng, cancel=cancel)
    limits = gap_limits(q, len(chosen) + len(kept), profile.plan.largest_gap)
    chosen = close_gaps(candidates, q, chosen, criterion, limits, without_turns(kept, q), rng, cancel)
    return most_informative_first(candidates, chosen, criterion)
