"""Loops of lost motion: what a joint lies behind its motor after upward and after downward motion."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.commands.discover.charts import picture_chart
from cellapp.commands.discover.words import picture_words
from cellapp.estimation.discovery.records import Picture
from cellapp.estimation.motion.discovery import loop_picture
from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import RecordedArm, motion_problem
from cellapp.estimation.motion.steps import loops
from cellapp.ground.progress import ignore_words
from cellapp.robot.kinematics.chain import nominal_geometry
from tests.estimation.motion.simulated import UR10, record, sweep, true_arm

PLAY = 50e-6


@pytest.fixture(scope="module")
def drawn():
    """Loops of joint 1, which has play, of joint 2 and of joint 6, of which the latter has none."""
    rng = np.random.default_rng(4)
    arm = true_arm(rng, half_play=[PLAY, PLAY, 0.0, 0.0, 0.0, 0.0])
    recording = record(rng, arm, sweep(rng, 6), seconds=90.0, slow=15e-6)
    problem, rows = motion_problem(
        RecordedArm(nominal_geometry(UR10, np.zeros(3)), [recording], tool_unknown=True), ignore_words
    )
    found = loops(problem, solve(problem, rows), [1, 2, 6])
    bare = problem.without_terms()
    return found, loops(bare, solve(bare, rows), [1])


def widths(loop):
    return [
        float(values[loop.direction < 0.0].mean() - values[loop.direction > 0.0].mean())
        for values in (loop.measured, loop.computed)
    ]


def test_the_loop_of_a_joint_is_as_wide_as_its_play(drawn):
    for loop in drawn[0][:2]:
        measured, computed = widths(loop)
        assert measured == pytest.approx(2 * PLAY, rel=0.1)
        assert computed == pytest.approx(2 * PLAY, rel=0.1)
    assert {loop.joint for loop in drawn[0]} == {1, 2, 6}
    assert widths(drawn[0][2])[1] < 0.4 * PLAY


def test_a_loop_is_measured_where_the_model_has_none(drawn):
    measured, computed = widths(drawn[1][0])
    assert computed == 0.0
    assert measured > 0.4 * PLAY, "a fit without play takes a part of it for geometry and for a delay, not all"


def test_a_picture_of_a_loop_draws_both_directions_and_says_its_width(drawn):
    picture = loop_picture(drawn[0][0])
    assert Picture.model_validate_json(picture.model_dump_json()) == picture
    chart = picture_chart("left", picture)
    assert [one.name for one in chart.series] == [
        f"{words}, {what}" for words in ("upward", "downward") for what in ("measured", "computed")
    ]
    upward, downward = chart.series[0], chart.series[2]
    assert upward.y.mean() < downward.y.mean(), "after upward motion a joint lies below its motor"
    assert "wide as measured" in picture_words(picture)
    assert chart.y.unit == "µrad"
