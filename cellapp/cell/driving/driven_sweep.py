"""Drive and record one sweep of one arm through its drivers: the controller's samples and the tracker's points.

If another arm swings at the same time, both are driven together and the joints of both are recorded; the tracker
follows the first. The timestamps of the second controller are converted to the first one's clock by the states of both
at the beginning.

Recording begins before the motion and ends after it, at rest; each device has timestamps of its own clock. If the beam
breaks, the arm slows down along its path and rests; the tracker is pointed at the SMR again, and the arm continues from
there: that is a separate recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from cellapp.cell.driving.beam import Beam, find_again
from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.live_sweep import LiveSweep
from cellapp.cell.driving.motion import WRONG_TARGET_M, Mover
from cellapp.cell.driving.reaction import StopReaction, cause_of
from cellapp.cell.safety.gate import CellBodies, predicted_smr
from cellapp.ground.control import JobControl
from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.sweep import Sweep
from drivers.arms.protocol import Arm, ArmError, PathFollower
from drivers.arms.recording import JointRecord, RecordingArm
from drivers.trackers.protocol import (
    Packet,
    StreamingTracker,
    TargetLost,
    Track,
    TrackerError,
    WrongTarget,
    stream_limits_of,
    stream_of,
)

_REST_S = 0.5
"""Recorded rest before and after the motion [s]."""
_STARTS_S = 1.0
"""Time to full speed [s] of a motion that continues in the middle of its path."""
_PULSES = 3
"""Number of pulses of the hardware trigger at either end of a recording."""
_FIRST_POINT_S = 1.0
_MOST_PARTS = 20
_SHORTEST_S = 0.5
"""Shorter parts [s] carry no information and are discarded."""


@dataclass(frozen=True)
class SweepPart:
    """Recording up to a break of the beam, or up to the end of the motion.

    ``reached_s`` is the time of the motion at which the arm came to rest [s]; None if at its end. ``beside`` are joint
    positions (n, K) [rad] of the arm that swung at the same time, at the timestamps of ``joints``.
    """

    joints: JointRecord
    track: Track
    reached_s: float | None
    beside: Array | None = None


def why_no_sweeps(cell: Cell, interval_s: float) -> str:
    """Return why sweeps cannot be recorded in a cell; empty if they can. Raise ``TrackerError``."""
    limits = stream_limits_of(cell.tracker)
    if limits is None:
        return "this tracker's driver does not measure an SMR while it moves"
    try:
        limits.check(interval_s)
    except ValueError as error:
        return f"collection.motion_rate: {error}"
    for name, arm in cell.arms.items():
        if not (isinstance(arm, PathFollower) and isinstance(arm, RecordingArm)):
            return f"arm {name}: its driver cannot follow and record a motion"
    return ""


@runtime_checkable
class _FollowedAndRecorded(Arm, PathFollower, RecordingArm, Protocol):
    """Arm of a cell in which sweeps can be recorded."""


@dataclass(frozen=True, eq=False)
class _Leg:
    """Path that an arm follows next: positions ``q`` (m, N) [rad], and their times ``s_s`` (m,) in its motion [s]."""

    arm: _FollowedAndRecorded
    q: Array
    s_s: Array

    def at_s(self, reached: float) -> float | None:
        """Return the time of the motion at a (fractional) row; None at the end."""
        early = reached < len(self.q) - 1
        return float(np.interp(reached, np.arange(len(self.s_s)), self.s_s)) if early else None


@dataclass(frozen=True)
class SweepDriver:
    """Driver of sweeps in an open cell; ``interval_s`` is the time between two points of the tracker [s]."""

    cell: Cell
    mover: Mover
    bodies: CellBodies
    reaction: StopReaction
    control: JobControl
    interval_s: float

    def drive(self, motions: Mapping[str, Sweep], note: Callable[[str], None], live: LiveSweep) -> Iterator[SweepPart]:
        """Drive one period of the motions of all moving arms; yield each part when it is recorded.

        The arms must be at the beginnings of their motions. The first arm is measured. ``live`` receives the progress.

        Raises
        ------
        MotionRefused
            If the gate refuses; the arms rest.
        CellStopped
            If anything stops the cell.
        TrackerError
            If the SMR is not found before the motion begins.
        """
        name, from_s = next(iter(motions)), dict.fromkeys(motions, 0.0)
        for part in range(1, _MOST_PARTS + 1):
            try:
                if part > 1:
                    find_again(self.cell, self.mover, self.control, name)
                found, reached = self._recorded(self._legs(motions, from_s), live)
            except (TargetLost, WrongTarget) as error:
                if part == 1:
                    raise
                note(f"arm {name}: the rest of its sweep is not recorded: {error}")
                break
            if found.reached_s is None or found.reached_s - from_s[name] > _SHORTEST_S:
                yield found
            if all(its_s is None for its_s in reached.values()):
                return
            from_s = {one: motions[one].period_s if its_s is None else its_s for one, its_s in reached.items()}
            if found.reached_s is None:
                break  # the beam broke at the end: the other arm completes its motion
            note(f"arm {name}: the beam broke {from_s[name]:.1f} s after its sweep began; it goes on from there")
        legs = self._legs(motions, from_s)
        own = legs[name]
        live.begin(own.arm, self.cell.clock, own.s_s, own.arm.path_period_s, recorded=False)
        self._follow(legs, live.look)
        live.end_unrecorded()

    def _legs(self, motions: Mapping[str, Sweep], from_s: Mapping[str, float]) -> dict[str, _Leg]:
        found = {}
        for name, motion in motions.items():
            arm = self.cell.arms[name]
            assert isinstance(arm, _FollowedAndRecorded)
            found[name] = _Leg(arm, *_rest_of(motion, from_s[name], arm.path_period_s))
        return found

    def _follow(self, legs: Mapping[str, _Leg], look: Callable[[], None]) -> dict[str, float | None]:
        """Let arms follow their legs; return the motion time at which each rested early [s], None if at its end."""
        if len(legs) == 1:
            ((name, leg),) = legs.items()
            reached = {name: self.mover.follow(name, leg.q, leg.s_s, leg.arm.path_period_s, look)}
        else:
            paths = {name: (leg.q, leg.arm.path_period_s) for name, leg in legs.items()}
            reached = self.mover.follow_together(paths, look)
        return {name: leg.at_s(reached[name]) for name, leg in legs.items()}

    def _recorded(self, legs: Mapping[str, _Leg], live: LiveSweep) -> tuple[SweepPart, Mapping[str, float | None]]:
        """Let arms follow their legs while recording; the tracker follows the first one.

        Return the part, and where each arm came to rest as ``_follow``.
        """
        name, streaming = next(iter(legs)), stream_of(self.cell.tracker)
        own, arms = legs[name], {one: leg.arm for one, leg in legs.items()}
        assert streaming is not None
        beam, recorded = Beam([*arms.values()], self.reaction), dict[str, RecordingArm]()

        def received(packet: Packet) -> None:
            beam.received(packet)
            live.received(packet)

        one = name
        try:
            for one, arm in arms.items():
                arm.start_recording()
                recorded[one] = arm
            later_s = self._later_s(arms)
            expected_M = predicted_smr(self.bodies, name, own.q[:1])[0]
            streaming.start_track(expected_M, self.interval_s, beam.lost, received)
            self._rest(own.arm)
            self._require_own(name, beam, expected_M)
            live.begin(own.arm, self.cell.clock, own.s_s, own.arm.path_period_s)
            reached = self._follow(legs, live.look)
            self._rest(own.arm)
            records = {}
            for one in [*recorded]:
                records[one] = recorded.pop(one).end_recording()
            track = streaming.end_track()
        except ArmError as error:
            self._give_up(recorded.values(), streaming)
            raise self.mover.stop_cell(cause_of(one, error)) from error
        except BaseException:
            self._give_up(recorded.values(), streaming)
            raise
        live.end(records[name], track, reached[name])
        stamps_s = records[name].time_s
        beside = [rows_at(stamps_s, its.time_s + later_s[one], its.q) for one, its in records.items() if one != name]
        return SweepPart(records[name], track, reached[name], *beside), reached

    def _later_s(self, arms: Mapping[str, Arm]) -> dict[str, float]:
        """Return the offset of the first controller's clock from each one's [s], accurate to some control cycles."""
        states = {name: arm.state().time_s for name, arm in arms.items()}
        first_s = next(iter(states.values()))
        return {name: first_s - its_s for name, its_s in states.items()}

    def _rest(self, arm: RecordingArm) -> None:
        """Rest while recording, with the pulses of the hardware trigger if there is one."""
        for _ in range(_PULSES):
            self.cell.clock.wait(_REST_S / _PULSES, self.control.wait)
            arm.pulse()
        self.control.check()
        self.reaction.check()

    def _require_own(self, name: str, beam: Beam, expected_M: Array) -> None:
        """Check that points arrive and belong to this arm's SMR. Raise ``TrackerError`` if not."""
        self.cell.tracker.confirm(_FIRST_POINT_S)
        if beam.error is not None:
            raise beam.error
        if beam.first is None:
            raise TargetLost(f"tracker: no point of arm {name} came while it rested")
        off_m = float(np.linalg.norm(beam.first.p_M[0] - expected_M))
        if off_m > WRONG_TARGET_M:
            raise WrongTarget(
                f"arm {name}: the tracker locked an SMR {off_m * 1e3:.0f} mm from where this one should be"
            )

    @staticmethod
    def _give_up(recorded: Iterable[RecordingArm], streaming: StreamingTracker) -> None:
        """End all recordings; ignore errors, because the original error is the one to report."""
        for arm in recorded:
            with suppress(ArmError):
                arm.end_recording()
        with suppress(TrackerError):
            streaming.end_track()


def _rest_of(sweep: Sweep, from_s: float, period_s: float) -> tuple[Array, Array]:
    """Return the motion from ``from_s`` [s] on: joint positions (m, N) [rad], one per ``period_s``, and their times in
    the motion (m,) [s]. In the middle of the path it starts slowly from rest."""
    rows = int(np.ceil(sweep.period_s / period_s))
    exact = replace(sweep, period_s=rows * period_s)
    scale = exact.period_s / sweep.period_s
    if from_s <= 0.0:
        s_s = np.asarray(np.arange(rows + 1) * period_s, dtype=np.float64)
        return exact.at(s_s), s_s / scale
    steps = max(round(_STARTS_S / period_s), 1)
    rate: Array = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, steps + 1) / steps))
    ramp = from_s * scale + period_s * np.concatenate([[0.0], np.cumsum(rate)])
    left = max(int(np.ceil((exact.period_s - ramp[-1]) / period_s)), 0)
    s_s = np.minimum(np.concatenate([ramp, ramp[-1] + period_s * np.arange(1, left + 1)]), exact.period_s)
    return exact.at(s_s), s_s / scale
