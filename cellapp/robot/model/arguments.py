"""Check arguments from Python callers: names of arms, shapes and units of joint positions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import Array

# -- Units that a caller may have mistaken ----------------------------------------------------------------------------

_WIDEST_RAD = 4.0 * math.pi
"""Two turns: more than the range of any joint of an industrial arm."""


def first_in_degrees(q: NDArray[Any]) -> tuple[int, int] | None:
    """Row and column of the first joint position that can only be in degrees, among ``q`` (n, N) meant as [rad].

    None unless most rows have one: a single row may be wrong without being in degrees.
    """
    wide = np.abs(q) > _WIDEST_RAD
    if 2 * np.count_nonzero(wide.any(axis=1)) <= len(q):
        return None
    row, joint = np.argwhere(wide)[0].tolist()
    return row, joint


Value = TypeVar("Value")


def of_arm(arms: Mapping[str, Value], name: str, owner: str) -> Value:
    """Return the value of the arm ``name``; ``owner`` names the owner of the arms in the message, as "this run".

    Raises
    ------
    InputError
        If there is no such arm; the message lists the arms.
    """
    if name in arms:
        return arms[name]
    raise InputError(f"no arm '{name}'; arms of {owner}: {', '.join(arms)}{did_you_mean(name, arms)}")


def configurations(q: ArrayLike, joints: int, arm: str = "") -> Array:
    """Convert joint positions to a float64 array (n, N) [rad] for N ``joints``; such an array is not copied.

    Raises
    ------
    InputError
        If they are no numbers or have another shape; the message begins with the name of the ``arm``, if it is given.
    """
    where = f"arm {arm}: q" if arm else "q"
    try:
        array = np.asarray(q, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where} is no array of numbers; expected shape (n, {joints}) [rad]") from None
    if array.shape == (joints,):
        raise InputError(
            f"{where} has shape ({joints},), expected (n, {joints}): one row a configuration;"
            " for a single one give q[np.newaxis]"
        )
    if array.ndim != 2 or array.shape[1] != joints:
        raise InputError(
            f"{where} has shape {array.shape}, expected (n, {joints}): n configurations of {joints} joints"
        )
    return array


def require_radians(q: Array, arm: str) -> None:
    """Raise ``InputError`` if ``q`` (n, N) is not finite, or if most rows are beyond two turns: in degrees."""
    if not np.isfinite(q).all():
        row, joint = np.argwhere(~np.isfinite(q))[0].tolist()
        raise InputError(f"arm {arm}: q[{row}, {joint}] is {q[row, joint]:g}; expected a finite number [rad]")
    if (place := first_in_degrees(q)) is not None:
        raise InputError(
            f"arm {arm}: q reaches {q[place]:g} and most rows are beyond two turns; expected radians."
            " np.radians(q) converts degrees"
        )


def too_heavy(payload_kg: Array, masses: Array) -> int | None:
    """Return the first row whose payload (n,) is heavier than the arm, the sum of its ``masses`` [kg]: none lifts that.

    None if there is no such row, or the masses are not known.
    """
    wrong = np.flatnonzero((payload_kg > np.sum(masses)) & (np.sum(masses) > 0.0))
    return int(wrong[0]) if len(wrong) else None
