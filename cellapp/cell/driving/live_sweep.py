"""Progress of a sweep for observers: incoming data are counted, and reported from the job's own thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass, field, replace

import numpy as np

from cellapp.ground.progress import SweepLive
from cellapp.robot.kinematics.transforms import Array
from drivers.arms.recording import JointRecord, RecordingArm, counts_so_far
from drivers.clock import Clock
from drivers.plant.sweep import SweepRecord
from drivers.trackers.protocol import Packet, Track

_TRACE_S = 0.1
"""Time between two points of the speed trace [s]: the noise of a point is then some 0.3 mm/s."""


@dataclass(frozen=True)
class _Counts:
    """Received and missing points and samples, as in ``SweepLive``."""

    points: int = 0
    points_missing: int = 0
    samples: int = 0
    samples_missing: int = 0

    def __add__(self, other: _Counts) -> _Counts:
        return _Counts(*map(sum, zip(astuple(self), astuple(other), strict=True)))


@dataclass
class _Part:
    """One recording from the start of its motion."""

    arm: RecordingArm
    clock: Clock
    s_s: Array
    period_s: float
    recorded: bool = True
    began_s: float | None = None
    points: int = 0
    first_s: float = 0.0
    latest_s: float = 0.0

    def reached_s(self) -> float:
        """Return the time in the motion that is being sent now [s]."""
        now_s = self.clock.now_s()
        if self.began_s is None:
            self.began_s = now_s
        return float(np.interp((now_s - self.began_s) / self.period_s, np.arange(len(self.s_s)), self.s_s))


@dataclass
class LiveSweep:
    """Progress of one sweep. ``received`` may be called from any thread, all else only from the job's thread.

    ``so_far`` is the last report, ``interval_s`` the period of the tracker's points [s]; ``tell`` receives each report.
    """

    so_far: SweepLive
    interval_s: float
    tell: Callable[[SweepLive], None]
    _packets: deque[Packet] = field(default_factory=deque)
    _part: _Part | None = None
    _ended: _Counts = _Counts()
    """Counts of the parts that have ended."""
    _began_s: float | None = None
    _last: tuple[float, Array] | None = None
    """Timestamp [s] and position [m] of the newest point of the trace."""
    _trace: list[tuple[float, float]] = field(default_factory=list)
    _arrived_s: float | None = None

    def received(self, packet: Packet) -> None:
        """Queue a packet for the job's thread."""
        self._packets.append(packet)

    def begin(self, arm: RecordingArm, clock: Clock, s_s: Array, period_s: float, *, recorded: bool = True) -> None:
        """Begin a part with the motion's times ``s_s`` (m,) [s], one per ``period_s`` [s]; usually recorded."""
        self._part, self._last = _Part(arm, clock, s_s, period_s, recorded), None

    def look(self) -> None:
        """Report the progress of the current part."""
        part = self._part
        assert part is not None
        if not part.recorded:
            self._say(replace(self.so_far, state="unrecorded", done_s=part.reached_s()), self._ended)
            return
        self._take(part)
        points = counts_so_far(part.points, part.first_s, part.latest_s, self.interval_s)
        age_s = None if self._arrived_s is None else max(part.clock.now_s() - self._arrived_s, 0.0)
        now = replace(self.so_far, state="moving", done_s=part.reached_s(), point_age_s=age_s)
        self._say(now, self._ended + _Counts(*points, *part.arm.recorded()))

    def end(self, joints: JointRecord, track: Track, reached_s: float | None) -> None:
        """End a recorded part: at ``reached_s`` of the motion, where the beam broke, or at its end if None."""
        if self._part is not None:
            self._take(self._part)
        counts = _Counts(len(track.p_M), track.missing(self.interval_s), len(joints.time_s), joints.missing)
        self._end(counts, reached_s)

    def end_unrecorded(self) -> None:
        """End the motion of the arm without a recording."""
        self._end(_Counts(), None)

    def calculated(self, record: SweepRecord) -> None:
        """Report a sweep that was computed as a whole; points without the beam are NaN."""
        seen = np.isfinite(record.p_M[:, 0])
        self._follow(record.point_time_s[seen], record.p_M[seen])
        self.so_far = replace(self.so_far, lost_beams=int(np.sum(np.diff(seen.astype(int)) < 0)))
        joints_s = record.joint_time_s
        samples = counts_so_far(len(joints_s), joints_s[0], joints_s[-1], float(np.median(np.diff(joints_s))))
        self._end(_Counts(int(seen.sum()), int((~seen).sum()), *samples), None)

    def _end(self, counts: _Counts, reached_s: float | None) -> None:
        """Report a part that ended at ``reached_s``, or at the end of the motion if None."""
        broken = reached_s is not None
        self._ended += counts
        now = replace(
            self.so_far,
            state="searching" if broken else "done",
            done_s=self.so_far.duration_s if reached_s is None else reached_s,
            lost_beams=self.so_far.lost_beams + broken,
            point_age_s=None,
        )
        self._say(now, self._ended)

    def _take(self, part: _Part) -> None:
        """Process the packets received since the last look."""
        while self._packets:
            packet = self._packets.popleft()
            if not len(packet.p_M):
                continue
            if not part.points:
                part.first_s = float(packet.device_time_s[0])
            part.points, part.latest_s = part.points + len(packet.p_M), float(packet.device_time_s[-1])
            self._arrived_s = packet.arrived_s
            self._follow(packet.device_time_s, packet.p_M)

    def _follow(self, time_s: Array, p_M: Array) -> None:
        """Add points (n, 3) [m] at timestamps (n,) [s] to the trace."""
        began_s = self._began_s = float(time_s[0]) if self._began_s is None else self._began_s
        self.so_far = replace(self.so_far, distance_m=float(np.linalg.norm(p_M[-1])))
        chosen = np.unique(np.floor((time_s - began_s) / _TRACE_S), return_index=True)[1]
        for at_s, place in zip(time_s[chosen].tolist(), p_M[chosen], strict=True):
            if self._last is not None:
                since_s = at_s - self._last[0]
                if since_s < 0.9 * _TRACE_S:
                    continue
                speed = 1e3 * float(np.linalg.norm(place - self._last[1])) / since_s
                self._trace.append((round(at_s - 0.5 * since_s - began_s, 3), round(speed, 2)))
            self._last = at_s, place

    def _say(self, now: SweepLive, counts: _Counts) -> None:
        """Report the progress of the sweep with the counts and the new part of the trace."""
        trace, self._trace = tuple(self._trace), []
        self.so_far = replace(now, **asdict(counts), trace=trace)
        self.tell(self.so_far)
