"""Handle breaks of the beam to a moving SMR: the arm slows down along its path; at rest the SMR is found again."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.motion import Mover
from cellapp.cell.driving.reaction import StopCause, StopReaction
from cellapp.ground.control import JobControl
from drivers.arms.protocol import ArmError, PathFollower
from drivers.trackers.protocol import Packet, TargetLost, TrackerError, WrongTarget

_TRIES = 3
"""Tries to find the SMR after a break; between them a person in the beam has ``_PAUSE_S`` [s] to leave."""
_PAUSE_S = 1.0


class Beam:
    """First packet and error of a track. Both methods may be called from any thread.

    Attributes
    ----------
    first : Packet or None
        First packet with a point.
    error : TrackerError or None
        Why the track ended: ``TargetLost`` if the beam broke, else the tracker died.
    """

    def __init__(self, moving: Sequence[PathFollower], reaction: StopReaction) -> None:
        self.first: Packet | None = None
        self.error: TrackerError | None = None
        self._moving, self._reaction = moving, reaction

    def received(self, packet: Packet) -> None:
        """Store the first packet with a point."""
        if self.first is None and len(packet.p_M):
            self.first = packet

    def lost(self, error: TrackerError) -> None:
        """Let all moving arms slow down along their paths and rest; if the tracker died, stop the cell."""
        self.error = error
        if not isinstance(error, TargetLost):
            self._reaction.trigger(StopCause("tracker", str(error)))
            return
        for arm in self._moving:
            with suppress(ArmError):  # the arm's own doubt stops the cell
                arm.end_path()


def find_again(cell: Cell, mover: Mover, control: JobControl, name: str) -> None:
    """Measure the SMR of an arm at rest where its beam broke, with retries. Raise ``TrackerError``, ``Cancelled``."""
    for left in range(_TRIES, 0, -1):
        try:
            mover.measure(name, mover.positions()[name])
            return
        except (TargetLost, WrongTarget):
            if left == 1:
                raise
        cell.clock.wait(_PAUSE_S, control.wait)
        control.check()
