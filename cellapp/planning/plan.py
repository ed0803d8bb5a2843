"""The verb: stops that the tracker can see, that are safe to stand at and safe to reach in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import RunFile
from cellapp.safety.bodies import place
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, clear_alone, refuse_motion, refuse_stop, visible

_BATCH = 4000
_MOST_BATCHES = 200
_TRIES_PER_STOP = 60


def plan_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> dict[str, Array]:
    """Plan the stops of a run and store them. Returns name -> (stops, N).

    Raises
    ------
    InputError
        If the geometry cannot reach so many stops.
    """
    plans = plan_stops(run.profile, listener, cancel)
    run.write_plan(plans)
    return plans


def plan_stops(profile: Profile, listener: Listener = ignore, cancel: CancelToken | None = None) -> dict[str, Array]:
    """Stops for all arms, name -> (stops, N) [rad], seeded by the profile.

    Configurations are drawn uniformly in joint space, kept where the tracker sees the SMR and the arm is clear of the
    floor and of itself, and put in random order (drift in time must not look like a function of the joints). A
    pair of them becomes the next stop when both arms can go there from the last stop at any relative speed.
    """
    cancel = cancel or CancelToken()
    cell = cell_bodies(profile)
    rng = np.random.default_rng([profile.seed, 0x9A7])
    wanted = profile.plan.stops
    pools = {name: _Pool(cell, profile, name, rng) for name in cell.arms}
    homes = home_positions(profile)
    here: Mapping[str, Array] = homes
    stops: dict[str, list[Array]] = {name: [] for name in cell.arms}
    refusal = ""
    for done in range(wanted):
        cancel.check()
        if done % 10 == 0:
            listener(Progress("plan", done, wanted))
        for _ in range(_TRIES_PER_STOP):
            there = {name: pool.draw() for name, pool in pools.items()}
            if not all_seen(cell, there):
                refusal = "an arm hides the other's SMR from the tracker"
                continue
            refusal = refuse_motion(cell, here, there)
            if not refusal and done == wanted - 1:
                refusal = refuse_motion(cell, there, homes)
            if not refusal:
                break
        else:
            raise InputError(
                f"plan: no way to stop {done + 1} of {wanted} after {_TRIES_PER_STOP} tries; the last was refused:"
                f" {refusal}. Ask for fewer stops, a smaller plan.clearance, or move bases or tracker"
            )
        here = there
        for name, q in there.items():
            stops[name].append(q)
    listener(Progress("plan", wanted, wanted, "done"))
    return {name: np.array(rows) for name, rows in stops.items()}


def draw_stops(
    cell: CellBodies, profile: Profile, count: int, rng: np.random.Generator, cancel: CancelToken | None = None
) -> dict[str, Array]:
    """Stops at which all arms may stand and be seen, name -> (count, N) [rad]; no way between them is checked.

    Raises
    ------
    InputError
        If there are not so many to be found.
    """
    cancel = cancel or CancelToken()
    pools = {name: _Pool(cell, profile, name, rng) for name in cell.arms}
    found: list[dict[str, Array]] = []
    for _ in range(count * _TRIES_PER_STOP):
        cancel.check()
        q = {name: pool.draw() for name, pool in pools.items()}
        if all_seen(cell, q) and not refuse_stop(cell, q):
            found.append(q)
            if len(found) == count:
                return {name: np.array([stop[name] for stop in found]) for name in cell.arms}
    raise InputError(
        f"plan: only {len(found)} of {count} stops were found at which all arms are seen and keep their clearance;"
        " ask for a smaller plan.clearance, or move bases or tracker"
    )


def rolled_stops(
    cell: CellBodies, stops: Mapping[str, Array], rolls: int, rng: np.random.Generator
) -> tuple[dict[str, Array], np.ndarray]:
    """Stops (n, N) with as many copies with another angle of each last joint as are seen and safe.

    Returns them, name -> (m, N), and the place (m,) in ``stops`` of each.
    """
    n = len(next(iter(stops.values())))
    place_of, kept = list(range(n)), [{name: q[k] for name, q in stops.items()} for k in range(n)]
    for k in np.repeat(np.arange(n), rolls).tolist():
        turned = {name: q[k].copy() for name, q in stops.items()}
        for name, q in turned.items():
            low, high = cell.arms[name].limits[-1]
            q[-1] = np.clip(q[-1] + rng.uniform(-math.pi, math.pi), low, high)
        if all_seen(cell, turned) and not refuse_stop(cell, turned):
            place_of.append(k)
            kept.append(turned)
    return {name: np.array([stop[name] for stop in kept]) for name in stops}, np.array(place_of, dtype=np.intp)


def all_seen(cell: CellBodies, q: Mapping[str, Array]) -> bool:
    """Whether the tracker sees the SMRs of all arms at one stop, name -> (N,)."""
    for name in q:
        others = {other: value[None] for other, value in q.items() if other != name}
        if not visible(cell, name, q[name][None], others)[0]:
            return False
    return True


class _Pool:
    """Visible and safe configurations of one arm, drawn in batches as they are needed."""

    def __init__(self, cell: CellBodies, profile: Profile, name: str, rng: np.random.Generator) -> None:
        self._cell, self._name, self._rng = cell, name, rng
        self._ready: list[Array] = []
        self._batches = 0
        limits = cell.arms[name].limits
        if profile.plan.ranges is not None:
            self._low, self._high = np.array(profile.plan.ranges).T
            self._low, self._high = np.maximum(self._low, limits[:, 0]), np.minimum(self._high, limits[:, 1])
            for j in np.flatnonzero(self._low > self._high):
                low, high = profile.plan.ranges[j]
                raise InputError(
                    f"plan.ranges: joint {j + 1}: nothing of [{low:g}, {high:g}] rad is inside the limits of arm {name}"
                )
        else:  # one turn shows all of a joint
            middle = np.clip(0.0, limits[:, 0] + math.pi, limits[:, 1] - math.pi)
            self._low = np.maximum(limits[:, 0], middle - math.pi)
            self._high = np.minimum(limits[:, 1], middle + math.pi)

    def draw(self) -> Array:
        empty = 0
        while not self._ready:
            q = self._rng.uniform(self._low, self._high, size=(_BATCH, len(self._low)))
            q = q[visible(self._cell, self._name, q)]
            bodies = place(self._cell.arms[self._name], q)
            clear = clear_alone(self._cell, bodies)
            self._ready = list(q[clear])
            empty += 1
            if empty > _MOST_BATCHES:
                raise InputError(
                    f"plan: arm {self._name}: the tracker sees none of {_MOST_BATCHES * _BATCH} random configurations"
                    " that are clear of the floor; check arms.*.base, tracker.pose, smr.normal and the limits"
                )
        return self._ready.pop()
