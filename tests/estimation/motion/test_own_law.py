"""A law of speeds that a plug-in adds: found in recordings, with its size; not where it is not, and not at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.motion.joint_path import joint_path
from cellapp.estimation.motion.streams import JointStream
from cellapp.estimation.motion.terms import state_in_motion
from cellapp.robot.effects import EFFECTS, Linear, motion_laws, own_law
from tests.estimation.motion.simulated import record, sweep, true_arm
from tests.estimation.motion.test_effects import found_in
from tests.interfaces.plugins.installed import EXAMPLE, add_distribution, installed
from tests.robot.effects.cell import context_of

GREASE = "grease_drag"
TRUE = np.array([120e-6, 160e-6, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture
def plugin(tmp_path):
    """The effect of the handbook, installed by its entry point."""
    module = (EXAMPLE / "cellapp_example" / "grease_drag.py").read_text("utf-8")
    entries = {"cellapp.robot.effects": {GREASE: "grease:grease_drag"}}
    with installed(add_distribution(tmp_path, "grease", entries, {"grease.py": module})):
        yield


def recording(seed, **changes):
    rng = np.random.default_rng(seed)
    return record(
        rng, replace(true_arm(rng), **changes), sweep(rng, 6, speed=0.8), seconds=200.0, point_hz=50.0, slow=20e-6
    )


def test_it_is_found_in_recordings_with_its_size(plugin):
    discovery, found = found_in(recording(11, drag=TRUE))
    assert set(found) == {GREASE}
    drag = found[GREASE]
    assert {1, 2} <= set(drag.joints)
    assert drag.names[:2] == ("drag1", "drag2")
    assert drag.values[:2] == pytest.approx(TRUE[:2], rel=0.1)
    assert not drag.at_rest
    assert "speeds" in drag.only_motion
    assert discovery.heldout_after_mm < discovery.heldout_before_mm
    assert discovery.terms == ()


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(plugin):
    assert found_in(recording(12))[0].effects == ()


def test_readings_at_rest_cannot_show_it(plugin):
    assert len(motion_laws(EFFECTS.values())) == 3
    assert "no speeds" in EFFECTS[GREASE].missing_data(context_of())


def test_a_law_of_speeds_takes_what_motion_has():
    def warm(qd, air_c, drag):
        return -drag * qd * air_c[:, None]

    with pytest.raises(ValueError, match=r"law warm: a law of speeds acts on joints and takes no other quantities"):
        own_law("warm", drag=Linear("s", 1e-2))(warm)


def test_accelerations_and_torques_reach_the_function():
    def swing(q, qd, qdd, tau, approach, sag):
        return sag * (qdd + tau * approach + q * qd)

    (law,) = motion_laws([own_law("swing", sag=Linear("rad", 1e-3))(swing)()])
    assert law.needs_torques
    state = {
        name: np.full((4, 6), value) for name, value in zip(("q", "qd", "qdd", "tau", "approach"), (1, 2, 3, 4, -1))
    }
    assert law.offset("sag", 2, state.__getitem__) == pytest.approx(np.full(4, 1.0))


def test_accelerations_are_those_of_the_path():
    t = np.arange(0.0, 4.0, 0.008)
    q = np.stack([0.5 * np.sin(2.0 * t), 0.2 * np.cos(3.0 * t)], axis=1)
    path = joint_path(JointStream(time_s=t, q=q))
    inside = np.linspace(0.5, 3.5, 40)
    found = state_in_motion(path, inside, None, torques=False).quantity("qdd")
    assert found == pytest.approx(
        np.stack([-2.0 * np.sin(2.0 * inside), -1.8 * np.cos(3.0 * inside)], axis=1), abs=0.02
    )
