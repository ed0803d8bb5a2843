"""The map of a profile that is being written: what is known so far, each arm in its own style."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.commands.plan.charts_placement import placement_chart
from cellapp.ground.profile import Pose

pytestmark = pytest.mark.fast

LEFT = Pose(position=(0.0, 0.85, 0.0), rpy=(0.0, 0.0, np.pi / 2))
TRACKER = Pose(position=(3.0, 0.85, 4.0))


def test_bases_and_tracker_stand_where_their_poses_say() -> None:
    chart = placement_chart({"right": None, "left": LEFT}, TRACKER)
    axis, base, _, tracker = chart.series
    assert np.allclose([axis.x, axis.y], [[0.0, 0.0], [0.85, 1.25]])
    assert (base.name, base.x.tolist(), base.y.tolist(), base.style) == ("left", [0.0], [0.85], 1)
    assert (tracker.x.tolist(), tracker.y.tolist()) == ([3.0], [0.85])
    assert chart.equal
    assert chart.message == "From above: left at 0.00, 0.85 m and the tracker, at least 5.0 m from the bases."


def test_nothing_known_is_said() -> None:
    chart = placement_chart({"left": None}, None)
    assert chart.is_empty
    assert chart.message.startswith("No map yet")
    assert placement_chart({}, TRACKER).message == "From above: the tracker."
