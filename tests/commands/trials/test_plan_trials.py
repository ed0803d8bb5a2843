"""``trials plans``: whole plans are checked by another collision library; a plan that collides is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.cell.planning.method import make_stops
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.trials.collision_check import CollisionCheck
from cellapp.commands.trials.plan_tables import plan_trial_sentences, plan_trial_tables
from cellapp.commands.trials.plan_trial import PlanTrialsResult, plan_trials
from cellapp.commands.trials.whole_plans import as_driven, planned_motions
from tests.twin import small_twin

STOPS = 8


def test_whole_plans_are_counted_checked_and_shown() -> None:
    result = plan_trials(small_twin(STOPS, plan={"effects": ("backlash",)}), [3], STOPS, 0, whole=STOPS)
    plans = result.plans
    assert [(one.seed, one.reached) for one in plans] == [(3, STOPS)]
    assert plans[0].motions >= 2 * STOPS + 1, "approach and last motion of each stop, and the way home"
    assert plans[0].collisions == 0
    assert result.complaints() == []
    assert result == PlanTrialsResult.from_json(result.to_json(), "here")
    titles = [table.title for table in plan_trial_tables(result)]
    assert len(titles) == 3
    assert all(table.rows for table in plan_trial_tables(result))
    assert plan_trial_sentences(result)
    bad = result.model_copy(update={"plans": (plans[0].model_copy(update={"collisions": 2}),)})
    assert bad.complaints() == ["seed 3: 2 motions collide"]


def test_a_motion_through_the_other_arm_is_found() -> None:
    profile = small_twin(STOPS, plan={"method": "random"})
    stops, _ = make_stops(profile)
    homes = home_positions(profile)
    stretched = np.radians([0.0, -5.0, 0.0, 0.0, 0.0, 0.0])  # towards the other arm
    through = {name: np.concatenate([q[:4], stretched[None], q[5:]]) for name, q in stops.q.items()}
    motions = planned_motions(as_driven(replace(stops, q=through, legs=((),) * len(stops)), homes), homes)
    found = list(CollisionCheck(profile).collisions(motions, np.random.default_rng(0)))
    assert found
    assert {found[0].first.split(":")[0], found[0].second.split(":")[0]} == {"left", "right"}
