"""A path of one arm while the tracker follows its SMR; one on which the beam broke is driven again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cellapp.cell.driving.beam import Beam, find_again
from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import Mover
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.ground.control import JobControl
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.paths.timing import Trajectory
from drivers.arms.protocol import FollowedPath, PathFollower
from drivers.trackers.protocol import TargetLost, Track, TrackerError, WrongTarget, stream_of

INTERVAL_S = 0.01
"""Of points measured while the arm moves: 1 mm at 100 mm/s."""
MOST_RUNS = 4
"""A path is driven so often at most: once, and again after each beam that broke."""


@dataclass(frozen=True, eq=False)
class TrackedPath:
    """A path that an arm followed to its end.

    Attributes
    ----------
    track : Track or None
        Points that were measured meanwhile; None: nothing was to be, or the tracker does not measure a moving SMR.
    arm : FollowedPath
        What the arm reports.
    began_s : float
        When it set out, on the cell's clock [s].
    lost_beams : int
        How often it was driven before and did not come to the end, as the beam broke.
    """

    track: Track | None
    arm: FollowedPath
    began_s: float
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
        start_M: Array | None = None,
        interval_s: float = INTERVAL_S,
    ) -> TrackedPath:
        """Let an arm follow a path, measured each ``interval_s`` [s] where ``start_M`` (3,) [m] is given.

        ``begin`` leads the arm to its beginning, where its SMR is at ``start_M``. Where the beam breaks, the arm slows
        down along the path and rests; the SMR is measured there, and the whole path is driven again from its beginning.

        Raises
        ------
        MotionRefused
            If the gate refuses.
        TargetLost, WrongTarget
            If the SMR is not seen at the beginning, or the beam broke ``MOST_RUNS`` times.
        CellStopped
            As ``Mover.follow``, and if an SMR whose beam broke is not found again.
        """
        if start_M is None or (streaming := stream_of(self.cell.tracker)) is None:
            begin()
            began_s = self.cell.clock.now_s()
            return TrackedPath(None, self._follow(name, trajectory), began_s)
        follower = self.cell.arms[name]
        assert isinstance(follower, PathFollower)
        for lost_beams in range(MOST_RUNS):
            begin()
            beam = Beam([follower], self.reaction)
            streaming.start_track(start_M, interval_s, beam.lost)
            began_s = self.cell.clock.now_s()
            try:
                arm = self._follow(name, trajectory)
            except BaseException:
                with suppress(TrackerError):  # why the arm did not come to the end is to be reported
                    streaming.end_track()
                raise
            track = streaming.end_track()
            if beam.error is None:
                within = (track.time_s >= began_s) & (track.time_s <= began_s + trajectory.duration_s)
                return TrackedPath(track.within(within), arm, began_s, lost_beams)
            self._find_again(name)
        raise TargetLost(
            f"arm {name}: the beam broke each of the {counted(MOST_RUNS, 'time')} that this path was driven; it is not"
            " measured. Look for what crosses the beam along it"
        )

    def _follow(self, name: str, trajectory: Trajectory) -> FollowedPath:
        return self.mover.follow(name, trajectory.q, trajectory.s, trajectory.period_s)

    def _find_again(self, name: str) -> None:
        """Measure the SMR where the arm rests, or stop the cell."""
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
