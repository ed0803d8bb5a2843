"""Description of a designed plan: what it tells against random stops, correlations of its factors, its time."""

from __future__ import annotations

import numpy as np

from cellapp.cell.planning.design_records import ArmDesign, PlanDesignResult
from cellapp.cell.planning.designed import DesignedStops
from cellapp.cell.planning.each_arm import of_each_arm
from cellapp.cell.planning.factor_correlations import correlations, travel_time
from cellapp.cell.planning.plan_quality import arm_design
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore

_SEED = 0xDE52


def design_result(
    profile: Profile,
    designed: DesignedStops,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> PlanDesignResult:
    """Compare the asked stops of a plan with random ones of the same number; reserves do not count.

    Raises ``Cancelled`` on request.
    """
    stops, pools = designed.stops, designed.pools
    rng = np.random.default_rng([profile.seed, _SEED])
    reserves = profile.plan.reserves(len(stops))
    asked = stops.take([stop for stop in range(len(stops)) if stop not in reserves])

    def compare(name: str, own_rng: np.random.Generator) -> ArmDesign:
        return arm_design(profile, pools[name], name, asked.q, own_rng, cancel=cancel)

    listener(Progress("compare", 0, len(pools), "with random stops"))
    arms = of_each_arm(compare, pools, rng)
    listener(Progress("compare", len(pools), len(pools), "done"))
    return PlanDesignResult(
        arms=arms,
        correlations=correlations(profile, cell_bodies(profile), asked),
        travel=travel_time(profile, asked, designed.finder, rng),
        detours=sum(bool(legs) for legs in asked.legs),
        blocks=len(np.unique(asked.block)),
        repeats=int(np.sum(asked.repeat_of >= 0)),
        notes=designed.given_up,
    )
