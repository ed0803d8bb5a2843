"""Read an arm whose ball a person guides by hand into a socket. Nothing is moved, no freedrive is started.

In a simulated cell a simulated person guides the arm. The position of a socket follows from its name and never changes;
names that differ only in a digit at the end, as ``front_0`` and ``front_1``, are sockets of one block, 50 mm apart.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from functools import partial

import numpy as np

from cellapp.cell.driving.cell import arm_context, build_plant
from cellapp.estimation.readings import Reading
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Nest
from cellapp.robot.kinematics.transforms import Array
from drivers.arms.protocol import ArmError, ArmTimeout
from drivers.plant import Plant
from drivers.plant.sockets import touches
from drivers.settings import SettingError

REST_S = 0.5
"""Rest [s] before an arm is read."""
PATIENCE_S = 2.0
"""Longest wait [s] for an arm to come to rest."""
BLOCK_M = 0.05
"""Distance of neighbouring sockets of a simulated block [m]."""
_SEATING_M = 1.5e-5
_SPREAD_RAD = 0.9
"""Largest rotation of the joints [rad] by a simulated person from a socket's first posture."""
_TURNED_RAD, _POSTURES = 2.0, 200
"""Largest rotation [rad], and number, of random postures of two simulated arms of which one carries a socket."""
_TRIES = 12

ReadTouch = Callable[[str, int], Reading]
"""Function: socket name and number of earlier touches -> reading of the arm; raises ``Moving``, ``HardwareError``."""


ReadBoth = Callable[[str, int], tuple[Array, Array]]
"""Function: name of a socket on the other arm's flange and number of earlier touches -> joint positions [rad] of the
arm with the ball and of the arm with the socket; raises as ``ReadTouch``."""


class Moving(InputError):
    """The arm does not rest; nothing was recorded."""


def touch_reader(profile: Profile, arm: str) -> ReadTouch:
    """Return the function that reads touches of an arm.

    Raises
    ------
    InputError
        If the profile has no such arm, or its driver has nothing to read.
    """
    if arm not in profile.arms:
        raise InputError(f"--arm: arm '{arm}' is not in the profile; arms are {', '.join(profile.arms)}")
    driver = profile.arms[arm].driver
    if driver.needs_plant:
        return partial(_simulated_touch, build_plant(profile), arm)
    if not driver.has_device:
        raise InputError(
            f"arms.{arm}.driver: kind '{driver.kind}' has no device to read; record touches with the robot's own means"
            " and give them to 'cellapp import'"
        )
    return partial(_read_touch, profile, arm)


def both_reader(profile: Profile, arm: str) -> ReadBoth:
    """Return the function that reads both arms of a pair, one of which carries a socket. Raise as ``touch_reader``."""
    (other,) = [name for name in profile.arms if name != arm]
    if profile.arms[arm].driver.needs_plant:
        return partial(_simulated_both, profile, arm, other)
    readers = [touch_reader(profile, name) for name in (arm, other)]

    def read(socket: str, before: int) -> tuple[Array, Array]:
        first, second = (one(socket, before).q for one in readers)
        return first, second

    return read


def _read_touch(profile: Profile, arm: str, point: str, before: int) -> Reading:
    its = profile.arms[arm]
    try:
        state = its.driver.read_at_rest(arm_context(arm, its), REST_S, PATIENCE_S)
    except SettingError as error:
        raise InputError(f"arms.{arm}.{error}") from error
    except ArmTimeout as error:
        raise Moving(f"arm {arm}: {error}") from error
    except ArmError as error:
        raise HardwareError(f"arm {arm}: {error}") from error
    return _reading(state.q, point, state.payload_kg, state.joint_temperature_c)


def _reading(q: Array, point: str, payload_kg: float | None, joint_temperature_c: Array | None) -> Reading:
    """Return a touch; the last joint motions are unknown because a person guided the arm."""
    return Reading(
        q=q,
        p_M=np.full(3, np.nan),
        approach=np.zeros(len(q), dtype=np.int8),
        payload_kg=payload_kg,
        joint_temperature_c=joint_temperature_c,
        point=point,
    )


def _simulated_touch(plant: Plant, arm: str, point: str, before: int) -> Reading:
    """Return a touch by a simulated person, in the socket's posture with index ``before``."""
    config = next(one for one in plant.config.arms if one.name == arm)
    low, high = config.limits.T
    block, number = _in_block(point)
    place = np.random.default_rng([plant.config.seed, zlib.crc32(block.encode())])
    middle = np.clip(plant.q(arm) + place.uniform(-0.6, 0.6, config.joints), low, high)
    centre = plant.smr_positions(arm, middle[None], approach=np.zeros((1, config.joints)))[0]
    socket = centre + np.array([number * BLOCK_M, 0.0, 0.0])
    rng = np.random.default_rng([plant.config.seed, zlib.crc32(point.encode()), before])
    for _ in range(_TRIES):
        starts = np.clip(middle + rng.uniform(-_SPREAD_RAD, _SPREAD_RAD, (4, config.joints)), low, high)
        found = touches(plant, arm, socket, starts, seating_m=_SEATING_M, rng=rng)
        if len(found):
            return _reading(found[0], point, plant.payload(arm)[0], plant.joint_temperatures_c(arm))
    raise InputError(f"arm {arm}: the simulated arm does not reach a socket '{point}'; take another name")


def _simulated_both(profile: Profile, arm: str, other: str, socket: str, before: int) -> tuple[Array, Array]:
    """Return postures with index ``before`` in which a simulated person seats the ball in the other arm's socket."""
    place = np.random.default_rng(zlib.crc32(socket.encode())).uniform([-0.05, -0.05, 0.01], [0.05, 0.05, 0.1]).tolist()
    smr = profile.arms[other].smr.model_copy(update={"name": "ball", "nests": {"socket": Nest(offset=tuple(place))}})
    carrier = profile.arms[other].model_copy(update={"smr": smr})
    plant = build_plant(profile.model_copy(update={"arms": {**profile.arms, other: carrier}}))
    rng = np.random.default_rng([plant.config.seed, zlib.crc32(socket.encode()), before])
    q, other_q = (_postures(plant, name, rng) for name in (arm, other))
    ball_M = plant.smr_positions(arm, q, approach=np.zeros_like(q))
    socket_M = plant.smr_positions(other, other_q, approach=np.zeros_like(other_q), nest="socket")
    apart_m = np.linalg.norm(socket_M[:, None] - ball_M, axis=2)
    for k in np.argsort(apart_m.min(axis=1))[:_TRIES].tolist():  # begin with the postures nearest to touching
        start = q[np.argmin(apart_m[k])][None]
        found = touches(plant, arm, socket_M[k], start, seating_m=_SEATING_M, rng=rng)
        if len(found):
            return found[0], other_q[k]
    raise InputError(f"arm {arm}: the simulated arm does not reach a socket on arm {other}")


def _postures(plant: Plant, arm: str, rng: np.random.Generator) -> Array:
    """Draw random postures (n, N) [rad] around the current one of a simulated arm."""
    low, high = next(one for one in plant.config.arms if one.name == arm).limits.T
    return np.clip(plant.q(arm) + rng.uniform(-_TURNED_RAD, _TURNED_RAD, (_POSTURES, len(low))), low, high)


def _in_block(point: str) -> tuple[str, int]:
    """Return the block of a simulated socket and its index there (0 to 9)."""
    named = re.fullmatch(r"(.*?)_?([0-9])", point)
    return (point, 0) if named is None else (named[1], int(named[2]))
