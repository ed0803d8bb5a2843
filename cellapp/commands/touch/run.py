"""The verb ``touch``: record an arm that a person leads by hand with a ball into sockets. It moves nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from cellapp.cell.driving.touching import Moving, ReadTouch, both_reader, touch_reader
from cellapp.cell.profile import load_profile
from cellapp.cell.run.distances import published_arm
from cellapp.cell.run.flange_touches import require_pair
from cellapp.cell.run.touches import store_distances, store_touch, touches_before, withdraw_last_touch
from cellapp.commands.record import Work
from cellapp.commands.touch.on_flange import FlangeHand, require_both_in_sockets
from cellapp.commands.touch.request import TouchRequest, socket_name
from cellapp.commands.touch.result import RecordedTouch, TouchedPoint, TouchResult
from cellapp.estimation.readings import Reading
from cellapp.estimation.readings.readings import joined
from cellapp.estimation.sockets.agreement import PointAgreement, agreements, nearest_point
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile

FAR_MM = 20.0
"""Distance from the other touches of a socket from which a touch is doubted: a published arm is more accurate."""
_NEARER = 0.5
"""Another socket is proposed if the touch is nearer to it than this share of that distance."""
_SAME_RAD = 0.02
"""Touches between which no joint turned by more than this share one posture [rad]."""
_ASKED = "socket, 'undo' or 'end'"
_T = TypeVar("_T")


def run(request: TouchRequest, work: Work) -> TouchResult:
    """Record touches: one, or those typed line by line."""
    profile = load_profile(request.profile)
    arm = _arm_of(profile, request.arm)
    touches_before(request.folder, profile, arm)  # report errors before reading the arm
    notes: list[str] = []
    if request.on_flange:
        return _on_flange(request, profile, arm, work)
    if request.undo:
        notes.append(_undone(request.folder, profile, arm))
        return _result(request, profile, arm, notes=notes)
    hand = _Hand(request.folder, profile, arm, touch_reader(profile, arm))
    refused = _recorded(hand, request, work)
    if request.distances is not None and touches_before(request.folder, profile, arm) is not None:
        store_distances(request.folder, request.distances)
        notes.append(f"the known distances of {request.distances} are stored")
    return _result(request, profile, arm, tuple(hand.recorded), notes, refused)


def _on_flange(request: TouchRequest, profile: Profile, arm: str, work: Work) -> TouchResult:
    """Record touches of a socket that the other arm carries."""
    require_pair(profile, "--on-flange")
    require_both_in_sockets(request.folder, profile)
    hand = FlangeHand(request.folder, profile, arm, both_reader(profile, arm))
    notes = [hand.undo()] if request.undo else []
    refused = "" if request.undo else _recorded(hand, request, work)
    return _result(request, profile, arm, tuple(hand.recorded), notes, refused, hand.points())


class _Recorder(Protocol[_T]):
    """Reads, doubts, stores and removes touches of one kind."""

    @property
    def recorded(self) -> list[RecordedTouch]: ...

    def touch(self, point: str, /) -> _T: ...

    def doubt(self, touch: _T, /) -> str: ...

    def store(self, touch: _T, /) -> str: ...

    def undo(self) -> str: ...


@dataclass(frozen=True, eq=False)
class _Hand:
    """An arm led by hand, the run, and the touches recorded in it."""

    folder: Path
    profile: Profile
    arm: str
    read: ReadTouch
    recorded: list[RecordedTouch] = field(default_factory=list)

    def touch(self, point: str) -> Reading:
        """Read the arm at rest in a socket."""
        before = touches_before(self.folder, self.profile, self.arm)
        return self.read(point, 0 if before is None else (before.point or ()).count(point))

    def doubt(self, touch: Reading) -> str:
        """Say why a touch may have the wrong socket name, by the published arm; empty if it looks right."""
        before = touches_before(self.folder, self.profile, self.arm)
        if before is None:
            return ""
        its = joined([before, touch.as_readings(int(before.configuration.max()) + 1)])
        geometry, row = published_arm(self.profile, self.arm, its), len(its) - 1
        own = next(one for one in agreements(geometry, its) if one.name == touch.point)
        off_mm = float(own.off_m[own.rows == row][0]) * 1e3
        name, near_m = nearest_point(geometry, its, row)
        if not off_mm > FAR_MM:
            return ""
        other = f"; it lies {near_m * 1e3:.0f} mm from '{name}'" if near_m * 1e3 < _NEARER * off_mm else ""
        return f"this touch lies {off_mm:.0f} mm from the others of '{touch.point}' by the published arm{other}"

    def store(self, touch: Reading) -> str:
        """Store a touch; say how it agrees with the others of its socket."""
        number = store_touch(self.folder, self.profile, self.arm, touch)
        point = str(touch.point)
        self.recorded.append(RecordedTouch(configuration=number, point=point))
        found = next(one for one in _points(self.folder, self.profile, self.arm) if one.name == point)
        worst = f", agree to {np.max(found.off_m) * 1e3:.1f} mm" if len(found.rows) > 1 else ""
        again = len(found.rows) > 1 and float(np.max(found.turned_rad)) < _SAME_RAD
        same = "; the joints stand as before, which says nothing: lead the arm to another posture" if again else ""
        return f"recorded: {counted(len(found.rows), 'touch', 'touches')} of '{point}'{worst}{same}"

    def undo(self) -> str:
        """Remove the last touch."""
        return _undone(self.folder, self.profile, self.arm)


def _recorded(hand: _Recorder[_T], request: TouchRequest, work: Work) -> str:
    """Record one touch or the typed ones; return the reason if it was refused."""
    return _once(hand, request) if request.point is not None else _by_lines(hand, work)


def _once(hand: _Recorder[_T], request: TouchRequest) -> str:
    """Record one touch; return the reason if it was refused."""
    try:
        touch = hand.touch(str(request.point))
    except Moving as error:
        return str(error)
    doubt = "" if request.sure else hand.doubt(touch)
    if doubt:
        return f"{doubt}; nothing was recorded. Correct the name, or insist with --sure"
    hand.store(touch)
    return ""


def _by_lines(hand: _Recorder[_T], work: Work) -> str:
    """Record typed touches; return a reason if one was refused and none recorded.

    Raises ``HardwareError`` if that was caused by a device.
    """
    last = ""
    failure: Exception | None = None
    while (line := work.line(f"{_ASKED}{f' (Enter: {last})' if last else ''}:")) is not None:
        word = line.strip() or last
        if word == "end":
            break
        try:
            if word == "undo":
                work.say(hand.undo())
                del hand.recorded[-1:]
                continue
            last = point = socket_name(word)
            touch = hand.touch(point)
            doubt = hand.doubt(touch)
            if doubt and work.line(f"{doubt}. Record it as '{point}' all the same? yes or no:") != "yes":
                raise InputError(f"{doubt}; it was not recorded")
            work.say(hand.store(touch))
        except (InputError, HardwareError, ValueError) as error:
            failure = error
            work.say(str(error))
    if isinstance(failure, HardwareError) and not hand.recorded:
        raise failure
    return "" if hand.recorded or failure is None else str(failure)


def _undone(folder: Path, profile: Profile, arm: str) -> str:
    point, number = withdraw_last_touch(folder, profile, arm)
    return f"the touch of '{point}' (configuration {number}) was taken back"


def _arm_of(profile: Profile, named: str | None) -> str:
    if named is None and len(profile.arms) > 1:
        raise InputError(f"--arm: say which arm is led; arms are {', '.join(profile.arms)}")
    arm = next(iter(profile.arms)) if named is None else named
    if arm not in profile.arms:
        raise InputError(f"--arm: arm '{arm}' is not in the profile; arms are {', '.join(profile.arms)}")
    return arm


def _points(folder: Path, profile: Profile, arm: str) -> tuple[PointAgreement, ...]:
    its = touches_before(folder, profile, arm)
    return () if its is None else agreements(published_arm(profile, arm, its), its)


def _result(
    request: TouchRequest,
    profile: Profile,
    arm: str,
    recorded: tuple[RecordedTouch, ...] = (),
    notes: list[str] | tuple[str, ...] = (),
    refused: str = "",
    carried: tuple[TouchedPoint, ...] = (),
) -> TouchResult:
    points = tuple(
        TouchedPoint(
            point=one.name,
            touches=len(one.rows),
            worst_mm=None if math.isnan(worst := float(np.max(one.off_m)) * 1e3) else worst,
            turned_deg=tuple(np.degrees(one.turned_rad).tolist()),
        )
        for one in _points(request.folder, profile, arm)
    )
    single = [one.point for one in points if one.touches == 1]
    more = [f"touched once, which says nothing yet: {', '.join(single)}"] if single else []
    return TouchResult(
        run=str(request.folder),
        arm=arm,
        recorded=recorded,
        points=(*points, *carried),
        notes=(*notes, *more),
        refused=refused,
    )
