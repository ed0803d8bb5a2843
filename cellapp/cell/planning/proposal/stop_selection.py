"""Greedy choice of further stops for all arms, among candidates that the safety gate lets them reach.

Stop by stop, each arm takes the candidate of the largest gain (sequential T-optimal design). The chosen stops are then
put in random order, so that time is confounded with nothing, as far as the arms can move from each to the next. Stops
that fit nowhere in that order are replaced.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.planned_stops import can_go
from cellapp.cell.planning.proposal.arm_candidates import ArmCandidates
from cellapp.cell.planning.proposal.candidate_poses import CandidatePoses, alone
from cellapp.cell.planning.stop_conditions import StopConditions
from cellapp.cell.safety.gate import refuse_motion, visible_stops
from cellapp.ground.progress import CancelToken, Listener, Progress
from cellapp.robot.kinematics.transforms import Array

_MOST_OFTEN = 3
"""How often a posture, whatever its wrist roll, is proposed at most: optimal designs repeat few stops, which would hide
that a law is wrong elsewhere."""
_REFUSALS = 400
"""Refusals in a row after which the search for a further stop ends: bounds the time in a crowded cell."""
_ROUNDS = 4
"""Rounds of replacing stops that fit nowhere in the order; each fills the gaps of the one before."""


@dataclass(frozen=True)
class ChosenStop:
    """The pose of each arm, and the approach to it."""

    poses: tuple[int, ...]
    approaches: tuple[int, ...]


@dataclass(eq=False)
class StopSelection:
    """The selection of stops for all arms.

    Attributes
    ----------
    arms, poses
        The candidates.
    paired : bool
        Keep poses of all arms together that were drawn together, as where an effect depends on the other arm. Else
        each arm's best poses are combined, if the gate accepts it.
    rng
    refused : set of ChosenStop
        Combinations that the gate refused.
    reachable : dict
        Cached answers of the gate for motions from one stop to the start of another's last step; None is home.
    """

    arms: Sequence[ArmCandidates]
    poses: CandidatePoses
    paired: bool
    rng: np.random.Generator
    refused: set[ChosenStop] = field(default_factory=set)
    reachable: dict[tuple[ChosenStop | None, ChosenStop | None], bool] = field(default_factory=dict)

    def select(self, count: int, listener: Listener, cancel: CancelToken) -> list[ChosenStop]:
        """Choose ``count`` stops, each reachable from the one before; fewer if the gate refuses."""
        kept: list[ChosenStop] = []
        for _ in range(_ROUNDS):
            for number, arm in enumerate(self.arms):
                arm.restart((one.poses[number], one.approaches[number]) for one in kept)
            before = len(kept)
            kept = self._ordered([*kept, *self._further(kept, count, listener, cancel)])
            if len(kept) == count or len(kept) == before:
                break
        return kept

    def target(self, stop: ChosenStop) -> dict[str, Array]:
        """Return the joint positions of the arms at a stop."""
        return {arm.name: self.poses.q[arm.name][pose] for arm, pose in zip(self.arms, stop.poses, strict=True)}

    def conditions(self, stop: ChosenStop) -> dict[str, StopConditions]:
        """Return approach and dwell that the collection has to realise at a stop."""
        chosen = zip(self.arms, stop.poses, stop.approaches, strict=True)
        return {arm.name: arm.stop_conditions(self.poses, pose, approach) for arm, pose, approach in chosen}

    def _further(
        self, kept: Sequence[ChosenStop], count: int, listener: Listener, cancel: CancelToken
    ) -> list[ChosenStop]:
        """Choose the missing stops one by one, each the best in addition to those before."""
        used = [np.zeros(int(self.poses.posture.max()) + 1, dtype=np.intp) for _ in self.arms]
        for earlier in kept:
            self._count(used, earlier)
        found: list[ChosenStop] = []
        while len(kept) + len(found) < count:
            cancel.check()
            listener(Progress("propose", len(kept) + len(found), count, "stops"))
            stop = self._next(used, count - len(kept) - len(found))
            if stop is None:
                break
            for arm, pose, approach in zip(self.arms, stop.poses, stop.approaches, strict=True):
                arm.add(pose, approach)
            self._count(used, stop)
            found.append(stop)
        return found

    def _count(self, used: list[NDArray[np.intp]], stop: ChosenStop) -> None:
        """Count the postures of a stop."""
        for counts, pose in zip(used, stop.poses, strict=True):
            counts[self.poses.posture[pose]] += 1

    def _next(self, used: list[NDArray[np.intp]], stops_left: int) -> ChosenStop | None:
        """Choose the best stop whose last steps the gate accepts; None if there is none."""
        gains = [arm.gains(stops_left) for arm in self.arms]
        for gain, counts in zip(gains, used, strict=True):
            gain[counts[self.poses.posture] >= _MOST_OFTEN] = -math.inf
        for _ in range(_REFUSALS):
            stop = self._best(gains)
            if stop is None:
                return None
            refused_arms = self._arms_refused_alone(stop)
            if not refused_arms and stop not in self.refused and not self._refused_together(stop):
                return stop
            self.refused.add(stop)
            for number in refused_arms:
                self.arms[number].allowed[stop.poses[number], stop.approaches[number]] = False
            for number in refused_arms or [_least_loss(gains, stop)]:
                gains[number][stop.poses[number], stop.approaches[number]] = -math.inf
        return None

    def _best(self, gains: Sequence[Array]) -> ChosenStop | None:
        """Return the stop of the largest gains (n, f) of each arm; None if an arm has no candidate left."""
        by_pose = [gain.max(axis=1) for gain in gains]
        if self.paired:
            by_pose = [np.sum(by_pose, axis=0)] * len(self.arms)
        poses = tuple(int(np.argmax(best)) for best in by_pose)
        if any(not math.isfinite(float(best[pose])) for best, pose in zip(by_pose, poses, strict=True)):
            return None
        return ChosenStop(poses, tuple(int(np.argmax(gain[pose])) for gain, pose in zip(gains, poses, strict=True)))

    def _start(self, stop: ChosenStop) -> dict[str, Array]:
        """Return where the last steps to a stop begin; an arm without one is there already."""
        starts = self.target(stop)
        for arm, pose, approach in zip(self.arms, stop.poses, stop.approaches, strict=True):
            start = arm.start_of_last_step(self.poses, pose, approach)
            if start is not None:
                starts[arm.name] = start
        return starts

    def _arms_refused_alone(self, stop: ChosenStop) -> list[int]:
        """Return indices of the arms whose last step the gate refuses whatever the others do."""
        gate = self.poses.gate
        if gate is None:
            return []
        target, start = self.target(stop), self._start(stop)
        return [
            number
            for number, arm in enumerate(self.arms)
            if start[arm.name] is not target[arm.name]
            and refuse_motion(alone(gate, arm.name), {arm.name: start[arm.name]}, {arm.name: target[arm.name]})
        ]

    def _refused_together(self, stop: ChosenStop) -> bool:
        """Return whether the tracker misses an SMR at a stop, or the gate refuses the last steps together."""
        gate = self.poses.gate
        if gate is None:
            return False
        target = self.target(stop)
        if not self.paired and not visible_stops(gate, {name: q[None] for name, q in target.items()})[0]:
            return True
        return bool(refuse_motion(gate, self._start(stop), target))

    def _ordered(self, chosen: Sequence[ChosenStop]) -> list[ChosenStop]:
        """Put the stops in random order, each reachable from the one before, without those that fit nowhere."""
        waiting = [chosen[k] for k in self.rng.permutation(len(chosen))]
        if self.poses.gate is None:
            return waiting
        path: list[ChosenStop] = []
        grown = True
        while waiting and grown:
            grown = False
            for stop in list(waiting):
                place = self._place_in(path, stop)
                if place is not None:
                    path.insert(place, stop)
                    waiting.remove(stop)
                    grown = True
        self.refused.update(waiting)
        return path

    def _place_in(self, path: Sequence[ChosenStop], stop: ChosenStop) -> int | None:
        """Find a random place in the order from and to which the arms can move; None if there is none."""
        for place in self.rng.permutation(len(path) + 1).tolist():
            before = path[place - 1] if place else None
            after = path[place] if place < len(path) else None
            if self._can_go(before, stop) and self._can_go(stop, after):
                return int(place)
        return None

    def _can_go(self, before: ChosenStop | None, after: ChosenStop | None) -> bool:
        """Return whether the arms can move from one stop to the start of another's last step; None is home."""
        if (before, after) not in self.reachable:
            gate = self.poses.gate
            assert gate is not None
            here = self.poses.homes if before is None else self.target(before)
            there = self.poses.homes if after is None else self._start(after)
            self.reachable[before, after] = can_go(gate, here, there)
        return self.reachable[before, after]


def _least_loss(gains: Sequence[Array], stop: ChosenStop) -> int:
    """Return the index of the arm whose second best candidate is nearest to its best."""
    losses = []
    for gain, pose, approach in zip(gains, stop.poses, stop.approaches, strict=True):
        rest = gain.copy()
        rest[pose, approach] = -math.inf
        losses.append(float(gain[pose, approach] - rest.max()))
    return int(np.argmin(losses))
