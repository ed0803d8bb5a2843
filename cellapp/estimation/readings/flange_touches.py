"""Touches of one arm's ball in sockets on the flange of the other arm: both arms' joints, and which socket."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class FlangeTouches:
    """n touches of an arm whose ball rests in a socket that the other arm of the cell carries.

    Attributes
    ----------
    socket : tuple of n str
        Name of the socket; those of one name are one place on the other arm's flange.
    q, other_q : arrays, shapes (n, N), (n, K)
        Joint positions of the arm with the ball, and of the one with the socket [rad].
    """

    socket: tuple[str, ...]
    q: Array
    other_q: Array

    def __len__(self) -> int:
        return len(self.socket)
