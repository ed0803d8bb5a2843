"""Drive a path of one arm while the tracker follows its SMR; drive it again if the beam broke."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import Mover
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.cell.driving.sweeping import Beam, find_again
from cellapp.ground.control import JobControl
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.joint_path import Trajectory
from drivers.arms.protocol import PathFollower
from drivers.trackers.protocol import TargetLost, Track, TrackerError, WrongTarget, stream_of

INTERVAL_S = 0.01
"""Interval of points measured while the arm moves [s]: 1 mm at 100 mm/s."""
MOST_RUNS = 4
"""Maximum number of runs of a path: one, and another one after each break of the beam."""


@dataclass(frozen=True, eq=False)
class TrackedPath:
    """Path that an arm followed to its end.

    Attributes
    ----------
    track : Track
        Points measured in the meantime.
    lost_beams : int
        Number of earlier runs that ended early because the beam broke.
    """

    track: Track
    lost_beams: int = 0


@dataclass(frozen=True, eq=False)
class PathDriver:
    """Drives paths in an open cell."""

    cell: Cell
    mover: Mover
    reaction: StopReaction
    control: JobControl

    def drive(
        self,
        name: str,
        trajectory: Trajectory,
        begin: Callable[[], None],
        start_M: Array,
        interval_s: float = INTERVAL_S,
    ) -> TrackedPath:
        """Let an arm follow a path, and measure its SMR every ``interval_s`` [s].

        ``begin`` moves the arm to the path's beginning, where its SMR is at ``start_M`` (3,) [m]. If the beam breaks,
        the arm slows down along the path and rests; its SMR is measured there, and the whole path is driven again. The
        tracker must be able to measure a moving SMR.

        Raises
        ------
        MotionRefused
            If the gate refuses.
        TargetLost, WrongTarget
            If the SMR is not seen at the beginning, or the beam broke in all ``MOST_RUNS`` runs.
        CellStopped
            As ``Mover.follow``, and if an SMR is not found again after a break of the beam.
        """
        streaming, follower = stream_of(self.cell.tracker), self.cell.arms[name]
        assert streaming is not None
        assert isinstance(follower, PathFollower)
        for lost_beams in range(MOST_RUNS):
            begin()
            beam = Beam([follower], self.reaction)
            streaming.start_track(start_M, interval_s, beam.lost)
            began_s = self.cell.clock.now_s()
            try:
                self.mover.follow({name: (trajectory.q, trajectory.period_s)})
            except BaseException:
                with suppress(TrackerError):  # report why the arm did not reach the end, not this
                    streaming.end_track()
                raise
            track = streaming.end_track()
            if beam.error is None:
                within = (track.time_s >= began_s) & (track.time_s <= began_s + trajectory.duration_s)
                return TrackedPath(track.within(within), lost_beams)
            self._find_again(name)
        raise TargetLost(
            f"arm {name}: the beam broke each of the {counted(MOST_RUNS, 'time')} that this path was driven; it is not"
            " measured. Look for what crosses the beam along it"
        )

    def _find_again(self, name: str) -> None:
        """Measure the SMR where the arm rests; stop the cell if it is not found."""
        try:
            find_again(self.cell, self.mover, self.control, name)
        except (TargetLost, WrongTarget) as error:
            raise self.mover.stop_cell(
                StopCause(
                    "tracker",
                    f"arm {name}: the beam broke while it followed a path, and its SMR is not found again: {error};"
                    " look for what covers it, then begin again",
                    name,
                )
            ) from error
