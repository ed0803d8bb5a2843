"""A check by touches of sockets: no false alarm, a changed joint is named, what touches cannot show is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check.touches import TouchCheck, check_touches
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import Geometry, JointAngles, joint_jacobian, parameter_names, smr_positions
from tests.estimation.monitoring.check.conftest import SIGMA_M, SimulatedCell, moved_base, with_parameter

pytestmark = pytest.mark.fast
Array = NDArray[np.float64]
TOUCHES = 10


def touched(true: Geometry, seed: int, *, sockets: int = 1, count: int = TOUCHES) -> Readings:
    """Touches of sockets by an arm of this true geometry, led there from random postures."""
    rng = np.random.default_rng([seed, 11])
    names, found = [], []
    for socket in range(sockets):
        q = rng.uniform(-1.8, 1.8, (count, true.joints))
        point = smr_positions(true, q[:1])[0]
        wanted = point + rng.normal(0.0, SIGMA_M, (count, 3))
        for _ in range(200):
            off = wanted - smr_positions(true, q)
            _, J = joint_jacobian(true, JointAngles.of(q))
            step = np.einsum("nja,na->nj", np.linalg.pinv(J.transpose(2, 0, 1)), off)
            q += step * np.minimum(1.0, 0.2 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        assert np.abs(wanted - smr_positions(true, q)).max() < 1e-9
        found.append(q)
        names += [f"socket {socket}"] * count
    q = np.concatenate(found)
    return Readings(
        configuration=np.arange(len(q)),
        time_s=np.full(len(q), np.nan),
        q=q,
        approach=np.zeros(q.shape, dtype=np.int8),
        p_M=np.full((len(q), 3), np.nan),
        point=tuple(names),
    )


def checked(cell: SimulatedCell, true: Geometry, seed: int, sockets: int = 1) -> TouchCheck:
    return check_touches(cell.belief, {"only": touched(true, seed, sockets=sockets)})


@pytest.mark.slow
def test_touches_of_an_unchanged_arm_are_no_change(single: SimulatedCell) -> None:
    found = [checked(single, single.true["only"], seed).conclusion for seed in range(12)]
    assert all(one.verdict in ("valid", "cannot say") for one in found)
    assert not any(one.changes for one in found)


@pytest.mark.parametrize("joint", [2, 3, 4, 5])
def test_a_changed_zero_of_a_joint_is_named(single: SimulatedCell, joint: int) -> None:
    place = parameter_names(6).index(f"theta{joint}")
    found = checked(single, with_parameter(single.true["only"], place, 3e-4), 1).conclusion
    assert found.verdict == "arm changed"
    named = [one for one in found.changes if one.what == f"zero of joint {joint}"]
    assert named, [one.what for one in found.changes]
    assert named[0].value == pytest.approx(3e-4, abs=6e-5)


def test_a_moved_base_is_not_shown_and_said_so(single: SimulatedCell) -> None:
    moved = moved_base(single.true["only"], [0.02, -0.01, 0.01], [0.01, 0.0, 0.02])
    found = checked(single, moved, 2)
    assert not found.conclusion.changes
    assert "tracker" in found.hidden
    assert "base of arm only" in found.hidden


def test_touches_begin_to_tell_from_the_second_one_of_a_socket(single: SimulatedCell) -> None:
    found = checked(single, single.true["only"], 3, sockets=2)
    assert len(found.standings) == 2 * (TOUCHES - 1)
    assert found.errors_m["only"].shape == (2 * TOUCHES,)


def test_too_few_touches_and_unknown_arms_are_refused(single: SimulatedCell) -> None:
    touches = touched(single.true["only"], 4)
    with pytest.raises(InputError, match="at least 4"):
        check_touches(single.belief, {"only": touches.take([0, 1])})
    with pytest.raises(InputError, match="no arm 'left'"):
        check_touches(single.belief, {"left": replace(touches)})
