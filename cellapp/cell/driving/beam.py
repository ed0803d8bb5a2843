"""The beam to an SMR that moves: where it breaks, the arm slows down along its way; at rest the SMR is found again."""

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
"""To find the SMR again after the beam broke; a person who stands in it has the pauses between them to leave."""
_PAUSE_S = 1.0


class Beam:
    """What a track has brought. Both methods are called from any thread.

    Attributes
    ----------
    first : Packet or None
        The first packet with a point.
    error : TrackerError or None
        Why the track has ended: ``TargetLost`` where the beam broke, else the tracker died.
    """

    def __init__(self, moving: Sequence[PathFollower], reaction: StopReaction) -> None:
        self.first: Packet | None = None
        self.error: TrackerError | None = None
        self._moving, self._reaction = moving, reaction

    def received(self, packet: Packet) -> None:
        """Keep the first packet with a point."""
        if self.first is None and len(packet.p_M):
            self.first = packet

    def lost(self, error: TrackerError) -> None:
        """Let all that move slow down along their paths and rest on them; a tracker that died stops the cell."""
        self.error = error
        if not isinstance(error, TargetLost):
            self._reaction.trigger(StopCause("tracker", str(error)))
            return
        for arm in self._moving:
            with suppress(ArmError):  # its own doubt stops the cell
                arm.end_path()


def find_again(cell: Cell, mover: Mover, control: JobControl, name: str) -> None:
    """Lead the tracker to the SMR of an arm that rests where its beam broke. Raises ``TrackerError``, ``Cancelled``."""
    for left in range(_TRIES, 0, -1):
        try:
            mover.measure(name, mover.positions()[name])
            return
        except (TargetLost, WrongTarget):
            if left == 1:
                raise
        cell.clock.wait(_PAUSE_S, control.wait)
        control.check()
