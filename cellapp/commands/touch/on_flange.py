"""Touches of sockets that the other arm carries: both arms are led by hand, and both arms' joints are recorded."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cellapp.cell.driving.touching import ReadBoth
from cellapp.cell.run.file import RunFile
from cellapp.cell.run.flange_touches import (
    FLANGE_TOUCHES_RESULT,
    OFF_M,
    FlangeTouch,
    flange_touches_of,
    flange_touches_text,
    off_m,
)
from cellapp.commands.touch.result import RecordedTouch, TouchedPoint
from cellapp.estimation.sockets import in_sockets
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True, eq=False)
class FlangeHand:
    """Two arms led by hand, ``arm`` with the ball; the run and the touches recorded in it."""

    folder: Path
    profile: Profile
    arm: str
    read: ReadBoth
    recorded: list[RecordedTouch] = field(default_factory=list)

    @property
    def other(self) -> str:
        """The arm with the socket."""
        return next(name for name in self.profile.arms if name != self.arm)

    def touch(self, socket: str) -> FlangeTouch:
        """Read both arms at rest in a socket."""
        with RunFile.open(self.folder) as run:
            touches = _all(run)
        return FlangeTouch(self.arm, socket, *self.read(socket, len(self._places(touches, socket))))

    def doubt(self, touch: FlangeTouch) -> str:
        """Say why a touch may have the wrong socket name, by the published arms; empty if it looks right."""
        with RunFile.open(self.folder) as run:
            off = float(self._off_m(run, [*_all(run), touch])[-1])
        if not off > OFF_M:
            return ""
        return f"this touch lies {off * 1e3:.0f} mm from the others of '{touch.socket}' by the published arms"

    def store(self, touch: FlangeTouch) -> str:
        """Store a touch; say how many its socket has."""
        with RunFile.open(self.folder, write=True) as run:
            touches = [*_all(run), touch]
            _write(run, touches, f"arm {self.arm}: touched '{touch.socket}' on arm {self.other}")
        self.recorded.append(RecordedTouch(configuration=len(touches), point=touch.socket))
        number = len(self._places(touches, touch.socket))
        return f"recorded: {counted(number, 'touch', 'touches')} of '{touch.socket}' on arm {self.other}"

    def undo(self) -> str:
        """Remove the last touch. Raises ``InputError`` if there is none."""
        with RunFile.open(self.folder, write=True) as run:
            touches = _all(run)
            own = [k for k, one in enumerate(touches) if one.arm == self.arm]
            if not own:
                raise InputError(f"{self.folder}: there is no touch on arm {self.other} to take back")
            last = touches.pop(own[-1])
            _write(run, touches, f"arm {self.arm}: a touch of '{last.socket}' on arm {self.other} was taken back")
        return f"the touch of '{last.socket}' on arm {self.other} was taken back"

    def points(self) -> tuple[TouchedPoint, ...]:
        """Return the sockets with their touches."""
        with RunFile.open(self.folder) as run:
            touches = _all(run)
            off = self._off_m(run, touches)
        found = []
        for name in dict.fromkeys(one.socket for one in touches if one.arm == self.arm):
            rows = self._places(touches, name)
            q = np.array([touches[k].q for k in rows])
            found.append(
                TouchedPoint(
                    point=f"{name} (on {self.other})",
                    touches=len(rows),
                    worst_mm=float(off[rows].max()) * 1e3 if off.any() else None,
                    turned_deg=tuple(np.degrees(np.ptp(q, axis=0)).tolist()),
                )
            )
        return tuple(found)

    def _places(self, touches: list[FlangeTouch], socket: str) -> list[int]:
        """Return the indices of the touches of a socket with this arm's ball."""
        return [k for k, one in enumerate(touches) if (one.arm, one.socket) == (self.arm, socket)]

    def _off_m(self, run: RunFile, touches: list[FlangeTouch]) -> Array:
        return off_m(self.profile, {name: run.rows(name) for name in self.profile.arms}, touches)


def require_both_in_sockets(folder: Path, profile: Profile) -> None:
    """Raise ``InputError`` unless the run has touches of fixed sockets by both arms."""
    with RunFile.open(folder) as run:
        missing = [name for name in profile.arms if name not in run.arms() or not in_sockets(run.rows(name))]
    if missing:
        raise InputError(
            f"{folder}: arm {missing[0]} has not touched sockets that stand still, from which it is calibrated; record"
            " these first, without --on-flange"
        )


def _all(run: RunFile) -> list[FlangeTouch]:
    return flange_touches_of(run.read_result(FLANGE_TOUCHES_RESULT))


def _write(run: RunFile, touches: list[FlangeTouch], words: str) -> None:
    run.write_result(FLANGE_TOUCHES_RESULT, flange_touches_text(touches))
    run.log("info", words)
