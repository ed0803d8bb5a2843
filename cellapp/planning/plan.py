"""Planning of stops that the tracker can see and that all arms reach without collision, in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import RunFile
from cellapp.safety.bodies import place
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, clear_alone, refuse_motion, refuse_stop, visible

_BATCH = 4000
"""Configurations drawn at once: about 60 of them are visible and safe in the twin cell, and they fit in the cache."""
_MOST_BATCHES = 200
"""Batches without a usable configuration after which the cell counts as impossible: 800 000 draws in a few seconds."""
_TRIES_PER_STOP = 60
"""Pairs of configurations tried for one stop. In the twin cell 58 % of pairs are accepted; with 8 % still 99 % of stops
are found."""
_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def plan_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> dict[str, Array]:
    """Plan the stops of a run and store them. Returns arm -> q (stops, N) [rad].

    Raises
    ------
    InputError
        If not enough stops can be reached.
    """
    plans = plan_stops(run.profile, listener, cancel)
    run.write_plan(plans)
    return plans


def plan_stops(profile: Profile, listener: Listener = ignore, cancel: CancelToken | None = None) -> dict[str, Array]:
    """Stops for all arms, arm -> q (stops + reserve, N) [rad], drawn with the profile's seed.

    Configurations are uniform in joint space, restricted to those where the tracker sees the SMR and the arm is clear
    of the floor and of itself. Their order is random, so that drift in time is not confounded with joint positions. A
    pair of configurations becomes the next stop if both arms can move there at any relative speed.
    """
    cancel = cancel or CancelToken()
    cell = cell_bodies(profile)
    rng = np.random.default_rng([profile.seed, 0x9A7])
    pools = {name: _ConfigurationPool(cell, profile, name, rng) for name in cell.arms}
    homes: Mapping[str, Array] = home_positions(profile)
    wanted = profile.plan.stops + profile.plan.reserve
    stops: list[Mapping[str, Array]] = []
    for number in range(1, wanted + 1):
        cancel.check()
        if (number - 1) % _PROGRESS_EVERY == 0:
            listener(Progress("plan", number - 1, wanted))
        q, refusal = _next_stop(cell, pools, stops[-1] if stops else homes, homes if number == wanted else None)
        if q is None:
            raise InputError(
                f"plan: stop {number} of {wanted} not found in {_TRIES_PER_STOP} tries; the last was refused:"
                f" {refusal}. Ask for fewer stops, a smaller plan.clearance, or move bases or tracker"
            )
        stops.append(q)
    listener(Progress("plan", wanted, wanted, "done"))
    return {name: np.array([stop[name] for stop in stops]) for name in cell.arms}


def draw_stops(
    cell: CellBodies, profile: Profile, count: int, rng: np.random.Generator, cancel: CancelToken | None = None
) -> dict[str, Array]:
    """Stops at which all arms may stand and are visible, arm -> q (count, N) [rad]; motions are not checked.

    Raises
    ------
    InputError
        If this number of stops is not found.
    """
    cancel = cancel or CancelToken()
    pools = {name: _ConfigurationPool(cell, profile, name, rng) for name in cell.arms}
    found: list[dict[str, Array]] = []
    for _ in range(count * _TRIES_PER_STOP):
        cancel.check()
        q = {name: pool.draw() for name, pool in pools.items()}
        if all_smrs_visible(cell, q) and not refuse_stop(cell, q):
            found.append(q)
            if len(found) == count:
                return {name: np.array([stop[name] for stop in found]) for name in cell.arms}
    raise InputError(
        f"plan: only {len(found)} of {count} stops were found at which all arms are visible and keep their clearance;"
        " ask for a smaller plan.clearance, or move bases or tracker"
    )


def rolled_stops(
    cell: CellBodies, stops: Mapping[str, Array], rolls: int, rng: np.random.Generator
) -> tuple[dict[str, Array], NDArray[np.intp]]:
    """Stops and up to ``rolls`` copies of each with other angles of the last joints, where visible and safe.

    Parameters
    ----------
    cell : CellBodies
    stops : mapping
        Arm -> q (n, N) [rad].
    rolls : int
    rng : numpy.random.Generator

    Returns
    -------
    stops : dict
        Arm -> q (m, N) [rad], the n given stops first.
    source : array, shape (m,)
        Index of the given stop from which each was made.
    """
    n = len(next(iter(stops.values())))
    source, kept = list(range(n)), [{name: q[k] for name, q in stops.items()} for k in range(n)]
    for k in np.repeat(np.arange(n), rolls).tolist():
        rolled = {name: q[k].copy() for name, q in stops.items()}
        for name, q in rolled.items():
            low, high = cell.arms[name].limits[-1]
            q[-1] = np.clip(q[-1] + rng.uniform(-math.pi, math.pi), low, high)
        if all_smrs_visible(cell, rolled) and not refuse_stop(cell, rolled):
            source.append(k)
            kept.append(rolled)
    return {name: np.array([stop[name] for stop in kept]) for name in stops}, np.array(source, dtype=np.intp)


def all_smrs_visible(cell: CellBodies, q: Mapping[str, Array]) -> bool:
    """Whether the tracker sees the SMRs of all arms at one stop, arm -> q (N,) [rad]."""
    for name in q:
        others = {other: value[None] for other, value in q.items() if other != name}
        if not visible(cell, name, q[name][None], others)[0]:
            return False
    return True


def _next_stop(
    cell: CellBodies,
    pools: Mapping[str, _ConfigurationPool],
    here: Mapping[str, Array],
    homes: Mapping[str, Array] | None,
) -> tuple[Mapping[str, Array] | None, str]:
    """A stop that can be reached from ``here`` and leads to ``homes`` if given; None with the last refusal."""
    refusal = ""
    for _ in range(_TRIES_PER_STOP):
        q = {name: pool.draw() for name, pool in pools.items()}
        if not all_smrs_visible(cell, q):
            refusal = "an arm or what it carries hides the other's SMR from the tracker"
            continue
        refusal = refuse_motion(cell, here, q)
        if not refusal and homes is not None:
            refusal = refuse_motion(cell, q, homes)
        if not refusal:
            return q, ""
    return None, refusal


def joint_ranges(cell: CellBodies, profile: Profile, name: str) -> Array:
    """Ranges from which the joint positions of an arm are drawn, lowest and highest, shape (N, 2) [rad].

    Raises
    ------
    InputError
        If a range of the plan is outside the arm's limits.
    """
    limits = cell.arms[name].limits
    if profile.plan.ranges is None:  # poses repeat after one turn of a joint: stay as near to zero as the limits allow
        middle = np.clip(0.0, limits[:, 0] + math.pi, limits[:, 1] - math.pi)
        return np.stack(
            [np.maximum(limits[:, 0], middle - math.pi), np.minimum(limits[:, 1], middle + math.pi)], axis=1
        )
    low, high = np.array(profile.plan.ranges).T
    ranges = np.stack([np.maximum(low, limits[:, 0]), np.minimum(high, limits[:, 1])], axis=1)
    for j in np.flatnonzero(ranges[:, 0] > ranges[:, 1]):
        raise InputError(
            f"plan.ranges: joint {j + 1}: no part of [{low[j]:g}, {high[j]:g}] rad is inside the limits of arm {name}"
        )
    return ranges


class _ConfigurationPool:
    """Visible and safe configurations of one arm, drawn in batches as they are needed."""

    def __init__(self, cell: CellBodies, profile: Profile, name: str, rng: np.random.Generator) -> None:
        self._cell, self._name, self._rng = cell, name, rng
        self._ready: list[Array] = []
        self._low, self._high = joint_ranges(cell, profile, name).T

    def draw(self) -> Array:
        """The next configuration (N,) [rad]. Raises ``InputError`` if none is found in many batches."""
        batches = 0
        while not self._ready:
            q = self._rng.uniform(self._low, self._high, size=(_BATCH, len(self._low)))
            q = q[visible(self._cell, self._name, q)]
            self._ready = list(q[clear_alone(self._cell, place(self._cell.arms[self._name], q))])
            batches += 1
            if batches > _MOST_BATCHES:
                raise InputError(
                    f"plan: arm {self._name}: the tracker sees none of {_MOST_BATCHES * _BATCH} random configurations"
                    " that are clear of the floor; check arms.*.base, tracker.pose, smr.normal and the limits"
                )
        return self._ready.pop()
