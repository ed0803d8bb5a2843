"""Plans by the method of the profile: alone, around kept stops, for one arm, down to a single stop."""

from __future__ import annotations

from typing import Any

import pytest

from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.planning.view import check_stops
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.cell.planning.hand_made import same_stops
from tests.twin import small_twin


def quick(stops: int, **plan: Any) -> Profile:
    """The twin with few candidates and one effect to design for."""
    return small_twin(stops, plan={"candidates": 120, "effects": ("backlash",), **plan})


def one_arm(profile: Profile) -> Profile:
    assert profile.plant is not None
    plant = profile.plant.model_copy(update={"effects": {}})
    return profile.model_copy(update={"arms": {"left": profile.arms["left"]}, "plant": plant})


@pytest.mark.parametrize("method", ["random", "designed"])
def test_plans_are_safe_and_follow_what_is_kept(method: str) -> None:
    profile = quick(4, method=method, reserve=1)
    stops, design = make_stops(profile)
    assert (len(stops), design is None) == (5, method == "random")
    more, _ = make_stops(profile, kept=stops, add=1)
    same_stops(more.take(range(5)), stops)
    assert len(more) == 6
    assert more.block[5] > stops.block.max()
    assert not [one for one in check_stops(profile, more) if not one.is_avoided]
    with pytest.raises(InputError, match="nothing is left to design"):
        make_stops(profile, kept=stops)


@pytest.mark.parametrize("method", ["random", "designed"])
def test_one_arm_alone_and_a_single_stop_are_planned(method: str) -> None:
    for profile, arms in ((one_arm(quick(3, method=method)), 1), (quick(1, method=method), 2)):
        stops: PlannedStops = make_stops(profile)[0]
        assert (len(stops), len(stops.q)) == (profile.plan.stops, arms)
        assert not [one for one in check_stops(profile, stops) if not one.is_avoided]
