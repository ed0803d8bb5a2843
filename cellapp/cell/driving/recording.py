"""Recorded events of a run's collection in chronological order; read only.

A run stores the readings, the reference measurements and the log. The motions between stops are not stored: an arm is
assumed to move straight to its next stop at the profile's speed and to arrive when its dwell began. Motions home and
for warming up are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import groupby
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.motion import motion_s
from cellapp.cell.driving.step_reports import missed_sentence, point_measured, record_sentence, state_of, vectors
from cellapp.cell.run import Event, Outcome, ReferenceRow, RunFile, Session
from cellapp.cell.run.collected import reference_drifts
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.readings import Reading, Readings
from cellapp.ground.errors import InputError
from cellapp.ground.progress import (
    AirReport,
    Detail,
    LogReport,
    MeasurementBegun,
    MotionBegun,
    MotionEnded,
    PointMissed,
    StateChange,
)
from cellapp.robot.model.nominal import joint_rates

UNTIMED_STOP_S = 10.0
"""Time per stop for readings without times [s]: a motion of some seconds, and a few seconds to measure two arms."""
_LAST_WORDS = timedelta(seconds=1.0)
"""A session logs its end within this time after it; later lines are from later verbs."""

Plan = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Visit:
    """Visit of a stop, with its readings in the order of measurement; none if every SMR was missed."""

    stop: int
    readings: Mapping[str, Reading]


@dataclass(frozen=True)
class ReferenceGroup:
    """Reference measurements made together; ``drift_mm`` is as in ``ReferenceReport``."""

    rows: tuple[ReferenceRow, ...]
    drift_mm: Mapping[str, float]


Step = Visit | ReferenceGroup
What = Detail | Step | str


@dataclass(frozen=True)
class Moment:
    """Event at a time of the run's clock [s]; a step is complete at that time, a text is a note.

    ``rank`` orders events of the same time: missed SMRs, then their steps, then other lines of the log.
    """

    time_s: float
    what: What
    rank: Literal[0, 1, 2] = 1


@dataclass(frozen=True)
class Recording:
    """All events of a run in chronological order.

    Attributes
    ----------
    moments : tuple of Moment
    visits : int
        Number of visited stops.
    readings : mapping
        Arm -> number of readings.
    planned : mapping
        Arm -> joint positions (n, N) [rad] of all stops; of the readings if there is no plan.
    timed : bool
        Whether the readings have times; if not, each stop takes ``UNTIMED_STOP_S``.
    """

    moments: tuple[Moment, ...]
    visits: int
    readings: Mapping[str, int]
    planned: Plan
    timed: bool

    @property
    def duration_s(self) -> float:
        """Time from the first moment to the last [s]."""
        return self.moments[-1].time_s - self.moments[0].time_s


def read_recording(run: RunFile) -> Recording:
    """Read what a run recorded. Raise ``InputError`` if there are no readings, or the file cannot be read."""
    readings = {name: run.readings(name) for name in run.arms()}
    if not readings:
        raise InputError(
            f"{run.path}: there are no readings to play back; collect or import some, or give another run's folder"
        )
    timed = all(bool(np.isfinite(arm.time_s).all()) for arm in readings.values())
    visits = _visits(readings, timed=timed)
    groups = _reference_groups(run) if timed else []
    times_s = [one.time_s for visit in visits for one in visit.readings.values()]
    times_s += [row.time_s for group in groups for row in group.rows]
    lines = _timed_lines(run, min(times_s), max(times_s))
    missed = {missed_sentence(one): one for one in run.outcomes() if one.kind == "not measured"}
    missed_s = {missed[line.text].stop: time_s for time_s, line in lines if line.text in missed}
    visits += [Visit(stop, {}) for stop in missed_s.keys() - {visit.stop for visit in visits}]
    plan = run.read_plan()
    timeline = _Timeline(run, plan, missed_s)
    steps: list[Step] = [*visits, *groups]
    for step in sorted(steps, key=timeline.begins_s):
        timeline.add(step)
    kinds = {record_sentence(kind, reason): kind for one in run.sessions() for _, kind, reason in one.requests}
    moments = timeline.moments
    for time_s, line in lines:
        moments += _line_moments(time_s, line, missed.get(line.text), kinds.get(line.text))
    return Recording(
        moments=tuple(sorted(moments, key=lambda moment: (moment.time_s, moment.rank))),
        visits=len(visits),
        readings={name: len(arm) for name, arm in readings.items()},
        planned=plan or {name: arm.q for name, arm in readings.items()},
        timed=timed,
    )


# -- readings ---------------------------------------------------------------------------------------------------------


def _visits(readings: Mapping[str, Readings], *, timed: bool) -> list[Visit]:
    """Group readings by stop in the order of measurement; arms measured there at other times are separate visits."""
    rows = [
        (one.time_s if timed else place, stop, name, one)
        for name, arm in readings.items()
        for place, stop, one in _rows(arm)
    ]
    rows.sort(key=lambda row: row[:2])
    visits = []
    for number, (stop, group) in enumerate(groupby(rows, key=lambda row: row[1])):
        visit = {name: one for _, _, name, one in group}
        if not timed:
            visit = {name: replace(one, time_s=(number + 1) * UNTIMED_STOP_S) for name, one in visit.items()}
        visits.append(Visit(stop, visit))
    return visits


def _rows(arm: Readings) -> Iterable[tuple[float, int, Reading]]:
    """Yield position in the order of measurement, stop, and reading."""
    for row, stop in enumerate(arm.configuration.tolist()):
        sigma_m, covariance_M = _number(arm.sigma_m, row), _given(arm.covariance_M, row)
        reading = Reading(
            q=arm.q[row],
            p_M=arm.p_M[row],
            time_s=float(arm.time_s[row]),
            temperature_c=_number(arm.temperature_c, row),
            joint_temperature_c=_given(arm.joint_temperature_c, row),
            dwell_s=_number(arm.dwell_s, row),
            covariance_M=covariance_M if covariance_M is not None or sigma_m is None else sigma_m**2 * np.eye(3),
        )
        place = _number(arm.sequence, row)
        yield stop if place is None else place, stop, reading


def _given(values: NDArray[np.float64] | None, row: int) -> NDArray[np.float64] | None:
    return None if values is None or np.isnan(values[row]).any() else values[row]


def _number(values: NDArray[np.float64] | None, row: int) -> float | None:
    return None if values is None or math.isnan(values[row]) else float(values[row])


def _reference_groups(run: RunFile) -> list[ReferenceGroup]:
    """Group references measured together: after the same number of stops of a session, each name once."""
    groups: list[list[tuple[ReferenceRow, float]]] = []
    for row, drift in zip(run.references(), reference_drifts(run), strict=True):
        latest = [one for one, _ in groups[-1]] if groups else []
        same = bool(latest) and (latest[0].session, latest[0].stops_done) == (row.session, row.stops_done)
        if not same or row.name in {one.name for one in latest}:
            groups.append([])
        groups[-1].append((row, drift.drift_mm))
    return [
        ReferenceGroup(tuple(row for row, _ in group), {row.name: drift_mm for row, drift_mm in group})
        for group in groups
    ]


# -- motions and measurements -----------------------------------------------------------------------------------------


class _Timeline:
    """Events of visits and reference measurements, with times that never decrease."""

    def __init__(self, run: RunFile, plan: Plan, missed_s: Mapping[int, float]) -> None:
        """``missed_s`` maps a stop to the time when the last SMR was missed there [s]."""
        self.moments: list[Moment] = []
        self._profile, self._plan, self._missed_s = run.profile, plan, missed_s
        self._half_s = 0.5 * run.profile.tracker.averaging
        self._q = home_positions(run.profile)
        left_out = {one.stop for one in run.outcomes() if one.kind == "left out"}
        stops = range(len(next(iter(plan.values()), ())))
        first = next((stop for stop in stops if stop not in left_out), 0)
        self._reference_q = {name: q[first] for name, q in plan.items() if len(q)}

    def begins_s(self, step: Step) -> float:
        """Return the time of the step's first measurement [s]."""
        if isinstance(step, ReferenceGroup):
            return step.rows[0].time_s
        return min((one.time_s for one in step.readings.values()), default=self._missed_s.get(step.stop, 0.0))

    def add(self, step: Step) -> None:
        """Append the events of a step; steps must come in the order of ``begins_s``."""
        if isinstance(step, ReferenceGroup):
            self._move("reference measurements", None, self._reference_q, {}, step.rows[0].time_s - self._half_s)
            self._at(step.rows[-1].time_s + self._half_s, step)
            return
        planned = {name: q[step.stop] for name, q in self._plan.items() if 0 <= step.stop < len(q)}
        self._move(f"stop {step.stop + 1}", step.stop, planned, step.readings, self._rest_s(step))
        temperatures_c = [one.temperature_c for one in step.readings.values() if one.temperature_c is not None]
        if self._profile.sensors.air is not None and temperatures_c:
            self._at(-math.inf, AirReport(temperatures_c[0]))
        for name, one in step.readings.items():
            self._at(one.time_s - self._half_s, MeasurementBegun(step.stop, name))
            self._at(one.time_s + self._half_s, point_measured(step.stop, name, one))
        self._at(self._missed_s.get(step.stop, -math.inf), step)

    def _at(self, time_s: float, what: What) -> None:
        before_s = self.moments[-1].time_s if self.moments else -math.inf
        self.moments.append(Moment(max(time_s, before_s), what))

    def _rest_s(self, visit: Visit) -> float:
        """Return when the dwell of the last arm begins [s]; the measurement begins later."""
        begins_s = self.begins_s(visit) - self._half_s
        rest_s = [one.time_s - one.dwell_s for one in visit.readings.values() if one.dwell_s is not None]
        return min(max(rest_s, default=begins_s), begins_s)

    def _move(
        self,
        note: str,
        stop: int | None,
        planned: Mapping[str, NDArray[np.float64]],
        readings: Mapping[str, Reading],
        ends_s: float,
    ) -> None:
        """Append a note and a motion, ending at ``ends_s`` [s], to planned positions, else those of the readings."""
        reached = {**planned, **{name: one.q for name, one in readings.items()}}
        targets = {**reached, **planned}
        start = {name: self._q.get(name, q) for name, q in targets.items()}
        self._q |= reached
        arms = self._profile.arms
        expected_s = max(
            (motion_s(q - start[name], *joint_rates(arms[name])) for name, q in targets.items()), default=0.0
        )
        warm = {name: one.joint_temperature_c for name, one in readings.items()}
        self._at(ends_s - expected_s, note)
        self._at(ends_s - expected_s, MotionBegun(stop, vectors(start), vectors(targets), expected_s))
        known = {name: one for name, one in warm.items() if one is not None}
        self._at(ends_s, MotionEnded(stop, vectors(reached), vectors(known)))


# -- the log ----------------------------------------------------------------------------------------------------------


def _line_moments(time_s: float, line: Event, missed: Outcome | None, kind: str | None) -> list[Moment]:
    """Return the events of a log line: a request recorded under ``kind``, a missed SMR, or the line itself."""
    state = None if kind is None else state_of(kind)
    if kind is not None and state is not None:
        return [Moment(time_s, StateChange(state, line.text.removeprefix(f"{kind}: ")), 2)]
    entry = LogReport(line.level, line.text)
    if missed is None:
        return [Moment(time_s, entry, 2)]
    begun, not_measured = MeasurementBegun(missed.stop, missed.arm), PointMissed(missed.stop, missed.arm, missed.reason)
    return [Moment(time_s, what, 0) for what in (begun, not_measured, entry)]


def _timed_lines(run: RunFile, first_s: float, last_s: float) -> list[tuple[float, Event]]:
    """Return the lines that collecting sessions logged, with their times on the run's clock [s].

    Lines before a session's first measurement have no such time, nor has any line of an older version. Their times are
    interpolated over the working time, which is the time within sessions.
    """
    sessions, events = run.sessions(), run.events()
    spans = _spans(sessions, events)
    lines = [one for one in events if any(began <= _utc(one.written) <= ended + _LAST_WORDS for began, ended in spans)]
    worked_s = [_worked_s(spans, _utc(one.written)) for one in lines]
    known = [(worked, one.time_s) for worked, one in zip(worked_s, lines, strict=True) if one.time_s is not None]
    latest_s = max([last_s, *(time_s for _, time_s in known)])
    total_s = sum((ended - began).total_seconds() for began, ended in spans)
    anchors = np.array([(0.0, first_s), *known, (total_s, latest_s)])
    placed_s = np.interp(worked_s, anchors[:, 0], np.maximum.accumulate(anchors[:, 1]))
    return [
        (float(placed) if line.time_s is None else line.time_s, line)
        for placed, line in zip(placed_s, lines, strict=True)
    ]


def _spans(sessions: Sequence[Session], events: Sequence[Event]) -> list[tuple[datetime, datetime]]:
    """Return begin and end of each session; a session in which the program died ends with its last log line."""
    began = [_utc(session.began) for session in sessions]
    next_began = [*began, None][1:]
    spans = []
    for session, begin, following in zip(sessions, began, next_began, strict=True):
        written = [_utc(event.written) for event in events]
        within = [when for when in written if begin <= when and (following is None or when < following)]
        spans.append((begin, max(within, default=begin) if session.ended is None else _utc(session.ended)))
    return spans


def _worked_s(spans: Sequence[tuple[datetime, datetime]], when: datetime) -> float:
    """Return the working time (within sessions) before ``when`` [s]."""
    return sum(max((min(when, ended) - began).total_seconds(), 0.0) for began, ended in spans)


def _utc(text: str) -> datetime:
    """Parse a stored time. Raise ``InputError`` if the text is no time."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"the run's log is damaged ('{text}' is not a time); restore the run from a copy") from None
    return when if when.tzinfo is not None else when.replace(tzinfo=UTC)
