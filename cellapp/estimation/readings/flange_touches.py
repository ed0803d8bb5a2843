"""Touches of one arm's ball in sockets on the flange of the other arm: joint positions of both arms, and the socket."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class FlangeTouches:
    """n touches of an arm whose ball rests in a socket on the other arm of the cell.

    Attributes
    ----------
    socket : tuple of n str
        Names of the sockets; equal names are one place on the other arm's flange.
    q, other_q : arrays, shapes (n, N), (n, K)
        Joint positions of the arm with the ball, and of the arm with the socket [rad].
    """

    socket: tuple[str, ...]
    q: Array
    other_q: Array

    def __len__(self) -> int:
        return len(self.socket)
