"""Conditions under which the simulated cell computes an arm at rest at given joint positions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

from drivers.plant.config import Array


class Conditions(TypedDict, total=False):
    """Conditions of an arm at rest. Missing keys and None have the default.

    Attributes
    ----------
    approach : array, shape (n, N)
        Sign of each joint's last motion; 0: in the middle of any play. Default: that of ``last_step``.
    others : mapping
        Joint angles (n, N) of other arms, by name; default: as they are now.
    other_payloads : mapping
        Loads (n,) [kg] of other arms, by name; default: as they are now.
    time_s : array, shape (n,)
        The cell's clock [s]; default: now. Temperatures at different times are one history.
    last_step : array, shape (n, N)
        The last motion of each joint, with its sign [rad]; default: a long one.
    since_rest_s : array, shape (n,)
        Time at rest [s]; default: infinite.
    payload, payload_center : arrays, shapes (n,), (n, 3) or (3,)
        Load [kg] and its centre in the flange frame [m]; default: the current ones.
    joints_c, air_c : arrays, shapes (n, N), (n,)
        Temperatures [degC]; default: the air at ``time_s``, and joints with their current rise above it.
    """

    approach: Array | None
    others: Mapping[str, Array] | None
    other_payloads: Mapping[str, Array] | None
    time_s: Array | None
    last_step: Array | None
    since_rest_s: Array | None
    payload: Array | None
    payload_center: Array | None
    joints_c: Array | None
    air_c: Array | None
