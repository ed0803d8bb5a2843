"""One sweep of one arm, driven and recorded through its drivers: the controller's samples and the tracker's points.

The devices begin before the motion and end after it, at rest, each with the stamps of its own clock. Where the beam
breaks, the arm slows down along its way and rests; the tracker is led to the SMR again, and the arm goes on from there:
what follows is a recording of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.driving.beam import Beam, find_again
from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.live_sweep import LiveSweep
from cellapp.cell.driving.motion import WRONG_TARGET_M, Mover
from cellapp.cell.driving.reaction import StopReaction, cause_of
from cellapp.cell.safety.gate import CellBodies, predicted_smr
from cellapp.ground.control import JobControl
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.sweep import Sweep
from drivers.arms.protocol import ArmError, PathFollower
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
"""Rest on record before and after the motion."""
_STARTS_S = 1.0
"""A motion that goes on in the middle of its way reaches its speed in this time."""
_PULSES = 3
"""Pulses of the hardware trigger at either end of a recording."""
_FIRST_POINT_S = 1.0
_MOST_PARTS = 20
_SHORTEST_S = 0.5
"""A part that is shorter tells nothing, and is not kept."""


@dataclass(frozen=True)
class SweepPart:
    """What was recorded up to where the beam broke, or up to the end of the motion.

    ``reached_s`` is the time of the motion at which the arm came to rest [s]; None: at its end.
    """

    joints: JointRecord
    track: Track
    reached_s: float | None


def why_no_sweeps(cell: Cell, interval_s: float) -> str:
    """Why sweeps cannot be recorded in a cell, in words; empty if they can. Raises ``TrackerError``."""
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


@dataclass(frozen=True)
class SweepDriver:
    """Drives sweeps in an open cell. ``interval_s`` lies between two points of the tracker [s]."""

    cell: Cell
    mover: Mover
    bodies: CellBodies
    reaction: StopReaction
    control: JobControl
    interval_s: float

    def drive(self, name: str, sweep: Sweep, note: Callable[[str], None], live: LiveSweep) -> Iterator[SweepPart]:
        """Drive a motion at whose beginning the arm is, and give each part when it is recorded.

        ``live`` is told what comes.

        Raises
        ------
        MotionRefused
            If the gate refuses; the arm rests.
        CellStopped
            If anything stops the cell.
        TrackerError
            If the SMR is not found before the motion begins.
        """
        arm = self.cell.arms[name]
        assert isinstance(arm, RecordingArm)
        assert isinstance(arm, PathFollower)
        from_s = 0.0
        for part in range(1, _MOST_PARTS + 1):
            q, s_s = _rest_of(sweep, from_s, arm.path_period_s)
            try:
                if part > 1:
                    find_again(self.cell, self.mover, self.control, name)
                found = self._recorded(name, q, s_s, live)
            except (TargetLost, WrongTarget) as error:
                if part == 1:
                    raise
                note(f"arm {name}: the rest of its sweep is not recorded: {error}")
                break
            if found.reached_s is None or found.reached_s - from_s > _SHORTEST_S:
                yield found
            if found.reached_s is None:
                return
            from_s = found.reached_s
            note(f"arm {name}: the beam broke {from_s:.1f} s after its sweep began; it goes on from there")
        q, s_s = _rest_of(sweep, from_s, arm.path_period_s)
        live.begin(arm, self.cell.clock, s_s, arm.path_period_s, recorded=False)
        self.mover.follow(name, q, s_s, arm.path_period_s, live.look)
        live.end_unrecorded()

    def _recorded(self, name: str, q: Array, s_s: Array, live: LiveSweep) -> SweepPart:
        """Follow ``q`` (m, N), which is at ``s_s`` (m,) [s] of the motion, on record."""
        arm, streaming = self.cell.arms[name], stream_of(self.cell.tracker)
        assert isinstance(arm, RecordingArm)
        assert isinstance(arm, PathFollower)
        assert streaming is not None
        beam, recorded = Beam(arm, self.reaction), False

        def received(packet: Packet) -> None:
            beam.received(packet)
            live.received(packet)

        try:
            arm.start_recording()
            recorded = True
            expected_M = predicted_smr(self.bodies, name, q[:1])[0]
            streaming.start_track(expected_M, self.interval_s, beam.lost, received)
            self._rest(arm)
            self._require_own(name, beam, expected_M)
            live.begin(arm, self.cell.clock, s_s, arm.path_period_s)
            followed = self.mover.follow(name, q, s_s, arm.path_period_s, live.look)
            self._rest(arm)
            joints, recorded = arm.end_recording(), False
            track = streaming.end_track()
        except ArmError as error:
            self._give_up(arm if recorded else None, streaming)
            raise self.mover.stop_cell(cause_of(name, error)) from error
        except BaseException:
            self._give_up(arm if recorded else None, streaming)
            raise
        early = followed.reached < len(q) - 1
        reached_s = float(np.interp(followed.reached, np.arange(len(s_s)), s_s)) if early else None
        live.end(joints, track, reached_s)
        return SweepPart(joints, track, reached_s)

    def _rest(self, arm: RecordingArm) -> None:
        """Rest on record, with the pulses of the hardware trigger where there is one."""
        for _ in range(_PULSES):
            self.cell.clock.wait(_REST_S / _PULSES, self.control.wait)
            arm.pulse()
        self.control.check()
        self.reaction.check()

    def _require_own(self, name: str, beam: Beam, expected_M: Array) -> None:
        """Make sure that points come, and that they are those of this arm's SMR. Raises ``TrackerError``."""
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
    def _give_up(arm: RecordingArm | None, streaming: StreamingTracker) -> None:
        """End what records; the reason why is the one to report."""
        if arm is not None:
            with suppress(ArmError):
                arm.end_recording()
        with suppress(TrackerError):
            streaming.end_track()


def _rest_of(sweep: Sweep, from_s: float, period_s: float) -> tuple[Array, Array]:
    """The motion from ``from_s`` [s] on: joint positions (m, N) [rad], one each ``period_s``, and where in it they are
    (m,) [s]. In the middle of its way it sets out slowly, from rest."""
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
