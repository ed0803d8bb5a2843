"""Record how an arm comes to rest at P1, tracked by the tracker: stabilisation time, overshoot, posing time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.cell.driving.iso9283.instrument import mpe_factor
from cellapp.cell.driving.motion import MotionRefused, Mover
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.estimation.discovery.plan_forecast import tracker_covariance
from cellapp.estimation.iso9283.evaluate_paths import PathTrack
from cellapp.estimation.iso9283.evaluate_settling import SettlingRuns
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.places import ArmProgramme
from cellapp.ground.control import JobControl
from cellapp.ground.profile import Profile
from drivers.trackers.protocol import StreamingTracker, TrackerError, stream_of

NO_STREAM = "this tracker's driver cannot measure a moving SMR"
_INTERVAL_S = 0.005
_BEFORE_S, _AFTER_S = 0.3, 2.0
"""Recorded rest [s] before the motion, and after the controller reports its end."""
_POSE, _BEFORE = "P1", "P2"
_BAND_M = 1e-4
"""Limit band [m] if the profile has no repeatability tolerance: the repeatability of arms of this class."""


@dataclass(frozen=True, eq=False)
class SettlingTests:
    """Records motions of one arm after the other in an open cell; ``hold`` is called between motions."""

    profile: Profile
    cell: Cell
    mover: Mover
    reaction: StopReaction
    findings: IsoFindings
    control: JobControl
    hold: Callable[[], None]
    cycles: int

    def drive(self, name: str, commands: tuple[IsoCommands, ...]) -> None:
        """Record the motions of an arm with each kind of commands, or why they cannot be recorded."""
        tracker = stream_of(self.cell.tracker)
        if tracker is None:
            self.findings.refuse(name, ["stabilisation"], NO_STREAM)
            return
        for kind in commands:
            programme = self.findings.programmes.get((name, kind))
            if programme is not None:
                self._drive(tracker, programme)

    def _drive(self, tracker: StreamingTracker, programme: ArmProgramme) -> None:
        start_M, end_M = programme.position_M[_BEFORE], programme.position_M[_POSE]
        runs = SettlingRuns(
            arm=programme.name,
            commands=programme.commands,
            pose=_POSE,
            before=_BEFORE,
            commanded_M=end_M,
            distance=float(np.linalg.norm(end_M - start_M)),
            band=self.profile.tolerances.pose_repeatability or _BAND_M,
            tracker=mpe_factor(self.profile) * tracker_covariance(self.profile.tracker, end_M[None])[0],
            wanted=self.cycles,
        )
        self.findings.settling.append(runs)
        try:
            for _ in range(self.cycles):
                self.hold()
                runs.tracks.append(self._record(tracker, programme))
        except (MotionRefused, TrackerError) as error:
            runs.problems.append(str(error))

    def _record(self, tracker: StreamingTracker, programme: ArmProgramme) -> PathTrack:
        name = programme.name
        start, end = programme.q[_BEFORE, "P3"], programme.q[_POSE, _BEFORE]
        self.mover.go_home_unless_clear(name, start)
        self.mover.move({name: start})
        tracker.start_track(programme.position_M[_BEFORE], _INTERVAL_S, self._beam_lost)
        try:
            self.mover.rest(name, (self.mover.rested_s(name) or 0.0) + _BEFORE_S, self.control)
            self.mover.move({name: end})
            self.mover.rest(name, _AFTER_S, self.control)
        except BaseException:
            with suppress(TrackerError):  # the cause of the halt is the one to report
                tracker.end_track()
            raise
        track = tracker.end_track()
        return PathTrack(track.time_s, track.p_M)

    def _beam_lost(self, error: TrackerError) -> None:
        self.reaction.trigger(StopCause("tracker", str(error)))
