"""A plan as CSV, to be edited by hand: header row, one row per arm for each point of each stop, SI units.

| column | meaning |
| --- | --- |
| configuration | number of the stop; stops are measured in the order of their numbers, which may have gaps |
| arm | name as in the profile |
| point | ``leg1``, ``leg2``, ... on the way, ``approach`` where the last motion begins, ``stop`` |
| q1..qN | joint positions [rad]; empty beyond the joints of the arm |
| dwell_s | least rest before the measurement [s] (optional; 0) |
| block | part of the run to which the stop belongs, from 0 (optional; 0) |
| repeat_of | configuration that is visited again (optional) |
| frozen | ``yes`` for a stop that a new design leaves as it is (optional; ``no``) |
| load | what the arms carry: 0 for ``payload`` of the profile, from 1 on ``payloads`` (optional; 0) |

Every arm of the profile has a row ``stop`` for each configuration. A leg has rows for the arms that move in it. Without
a row ``approach``, the last motion of an arm comes straight from the point before. The last five columns belong to rows
``stop``. Block, repeat_of, frozen and load are the same for all arms: they agree, or are empty for some.

Numbers are written in their shortest exact form: reading a file again gives the same plan bit for bit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellapp.cell.planning.planned_stops import LONGEST_DWELL_S, Configuration, PlannedStops, straight_stops
from cellapp.cell.run.csv_text import NUMBER, WHOLE, CsvTable, Problems, read_csv_table, short, write_csv
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.transforms import Array

STOP, APPROACH = "stop", "approach"
_POINT = re.compile(r"stop|approach|leg([1-9][0-9]{0,2})")
_KEYS = ("configuration", "arm", "point")
_OF_STOP = ("dwell_s", "block", "repeat_of", "frozen", "load")
_WORDS = {"no": False, "yes": True}
_ROUNDING_RAD = 1e-9
"""Tolerance of joint limits for rounding, as in the safety gate."""


@dataclass(frozen=True, eq=False)
class PlanFile:
    """A plan that was read from a file.

    Attributes
    ----------
    path : Path
    stops : PlannedStops
        The stops by ascending configuration.
    configurations : tuple of int
        Number of each stop in the file.
    lines : tuple of int
        Line of the first row of each stop.
    """

    path: Path
    stops: PlannedStops
    configurations: tuple[int, ...]
    lines: tuple[int, ...]


def write_plan_csv(stops: PlannedStops, path: Path, outputs: Outputs = NEW_ONLY) -> None:
    """Write a plan, which must have stops. Raise ``InputError`` if the file cannot or must not be written."""
    joints = max(q.shape[1] for q in stops.q.values())
    of_stop = _OF_STOP if stops.load.any() else _OF_STOP[:-1]
    header = [*_KEYS, *(f"q{joint + 1}" for joint in range(joints)), *of_stop]
    write_csv(Path(path), header, _rows(stops, joints, len(of_stop)), outputs)


def read_plan_csv(path: Path, profile: Profile) -> PlanFile:
    """Read a plan for the arms of a profile. It is not checked here whether it is safe and visible.

    Raises
    ------
    InputError
        Names file, line and column of what is missing, not a number, repeated, out of limits, or misplaced.
    """
    table = read_csv_table(Path(path), "planned stops, as 'cellapp export DIR --plan FILE' writes it")
    problems = Problems(table.place)
    _check_header(table, profile, problems)
    points = _Points(table, profile, problems)
    problems.check()
    if not points.by_stop:
        raise InputError(f"{path}:1: there is a header row but no stop; expected a row per arm and stop")
    numbers = sorted(points.by_stop)
    stops = points.planned(numbers)
    problems.check()
    return PlanFile(table.path, stops, tuple(numbers), tuple(points.first_line[number] for number in numbers))


# -- writing ----------------------------------------------------------------------------------------------------------


def _rows(stops: PlannedStops, joints: int, of_stops: int) -> Iterator[list[str]]:
    nothing = [""] * of_stops
    for stop in range(len(stops)):

        def row(name: str, point: str, q: Array, of_stop: Sequence[str] = nothing, number: int = stop) -> list[str]:
            cells = [repr(value) for value in q.tolist()]
            return [str(number), name, point, *cells, *[""] * (joints - len(cells)), *of_stop]

        for place, leg in enumerate(stops.legs[stop], start=1):
            yield from (row(name, f"leg{place}", q) for name, q in leg.items())
        yield from (row(name, APPROACH, q) for name, q in stops.approach_starts(stop).items())
        source = int(stops.repeat_of[stop])
        for name, q in stops.targets(stop).items():
            dwell_s = repr(float(stops.dwell_s[name][stop]))
            repeated = "" if source < 0 else str(source)
            frozen = "yes" if stops.frozen[stop] else "no"
            cells = [dwell_s, str(int(stops.block[stop])), repeated, frozen, str(int(stops.load[stop]))]
            yield row(name, STOP, q, cells[:of_stops])


# -- reading ----------------------------------------------------------------------------------------------------------


def _check_header(table: CsvTable, profile: Profile, problems: Problems) -> None:
    names = table.names
    required = [*_KEYS, *_joint_columns(max(len(arm.type.joints) for arm in profile.arms.values()))]
    known = [*required, *_OF_STOP]
    for name in required:
        if name not in names:
            problems.add(1, name, "the column is missing")
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known, "is '{}' meant?", otherwise=f"columns are {', '.join(known)}")
            problems.add(1, name, f"the column is unknown; {hint}")
    problems.check()


def _joint_columns(joints: int) -> list[str]:
    return [f"q{joint + 1}" for joint in range(joints)]


class _PlanPoint(NamedTuple):
    """One row: joint positions, and the filled ones of the cells that belong to rows ``stop`` only."""

    line: int
    q: Array
    of_stop: Mapping[str, Any]


class _Points:
    """The rows of a file by configuration, arm and point; errors are collected in ``problems``."""

    def __init__(self, table: CsvTable, profile: Profile, problems: Problems) -> None:
        self._table, self._profile, self._problems = table, profile, problems
        self.by_stop: dict[int, dict[str, dict[str, _PlanPoint]]] = {}
        self.first_line: dict[int, int] = {}
        for index, line in enumerate(table.lines):
            self._add(line, {name: cells[index].strip() for name, cells in table.cells.items()})

    # -- rows ----------------------------------------------------------------------------------------------------------

    def _add(self, line: int, cells: Mapping[str, str]) -> None:
        before = self._problems.count
        number = self._whole(line, "configuration", cells["configuration"])
        name, point = cells["arm"], cells["point"]
        if name not in self._profile.arms:
            what = f"arm '{short(name)}' is not in the profile" if name else "the value is missing"
            self._problems.add(line, "arm", f"{what}; arms are {', '.join(self._profile.arms)}")
        if not _POINT.fullmatch(point):
            self._problems.add(line, "point", f"expected leg1, leg2, ..., approach or stop, got '{short(point)}'")
        if self._problems.count > before:
            return
        q = self._joint_positions(line, cells, name, self._profile.arms[name])
        of_stop = {one: self._of_stop(line, one, cells[one], point) for one in _OF_STOP if cells.get(one)}
        if self._problems.count > before:
            return
        points = self.by_stop.setdefault(number, {}).setdefault(name, {})
        self.first_line.setdefault(number, line)
        if point in points:
            text = f"{number} of arm {name} has a row '{point}' in line {points[point].line} already; keep one"
            self._problems.add(line, "configuration", text)
        else:
            points[point] = _PlanPoint(line, np.array(q, dtype=np.float64), of_stop)

    def _joint_positions(self, line: int, cells: Mapping[str, str], name: str, arm: Arm) -> list[float]:
        limits = arm.joint_limits
        found = []
        for joint, (low, high) in enumerate(limits):
            column = f"q{joint + 1}"
            found.append(value := self._number(line, column, cells[column]))
            if not low - _ROUNDING_RAD <= value <= high + _ROUNDING_RAD:
                text = f"{value:g} rad is outside the limits {low:g} to {high:g} rad of arm {name}"
                self._problems.add(line, column, text)
        for column in _joint_columns(len(self._table.names))[len(limits) :]:
            if cells.get(column):
                self._problems.add(line, column, f"there is a value, but arm {name} has {len(limits)} joints")
        return found

    def _of_stop(self, line: int, column: str, text: str, point: str) -> float | int | bool | None:
        """Parse a filled cell that describes a stop."""
        if point != STOP:
            self._problems.add(line, column, f"there is a value, but it belongs to the row '{STOP}' of this arm")
            return None
        if column == "dwell_s":
            dwell_s = self._number(line, column, text)
            if not 0.0 <= dwell_s <= LONGEST_DWELL_S:
                self._problems.add(line, column, f"expected 0 to {LONGEST_DWELL_S:g} s, got {dwell_s:g}")
            return dwell_s
        if column == "frozen":
            if text.lower() not in _WORDS:
                self._problems.add(line, column, f"expected yes or no, got '{short(text)}'")
            return _WORDS.get(text.lower())
        number, most = self._whole(line, column, text), self._profile.loads - 1
        if column == "load" and number > most:
            self._problems.add(
                line, column, f"there is no load {number}; with arms.NAME.payloads there are 0 to {most}"
            )
        return number

    def _number(self, line: int, column: str, text: str) -> float:
        """Parse a finite number; NaN with a problem for another text."""
        value = float(text) if NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(value):
            what = f"expected a finite number such as 0.25, got '{short(text)}'" if text else "the value is missing"
            self._problems.add(line, column, what)
        return value

    def _whole(self, line: int, column: str, text: str) -> int:
        """Parse a whole number from 0; -1 with a problem for another text."""
        if WHOLE.fullmatch(text) and int(text) >= 0:
            return int(text)
        what = f"expected a whole number from 0, got '{short(text)}'" if text else "the value is missing"
        self._problems.add(line, column, what)
        return -1

    # -- stops ---------------------------------------------------------------------------------------------------------

    def planned(self, numbers: Sequence[int]) -> PlannedStops:
        """Assemble the stops in this order; errors are collected in ``problems``."""
        before = self._problems.count
        for number in numbers:
            self._check_stop(number)
        if self._problems.count > before:
            return straight_stops({})
        place = {number: stop for stop, number in enumerate(numbers)}
        arms = list(self._profile.arms)
        rows = {name: [self.by_stop[number][name] for number in numbers] for name in arms}
        repeats = [self._agreed(number, "repeat_of") for number in numbers]
        return PlannedStops(
            q={name: np.array([row[STOP].q for row in rows[name]]) for name in arms},
            approach_from={name: np.array([_approach(row) for row in rows[name]]) for name in arms},
            dwell_s={name: np.array([row[STOP].of_stop.get("dwell_s", 0.0) for row in rows[name]]) for name in arms},
            legs=tuple(self._legs(number) for number in numbers),
            block=np.array([self._agreed(number, "block") or 0 for number in numbers], dtype=np.intp),
            repeat_of=np.array([-1 if one is None else place[one] for one in repeats], dtype=np.intp),
            frozen=np.array([bool(self._agreed(number, "frozen")) for number in numbers], dtype=np.bool_),
            load=np.array([self._agreed(number, "load") or 0 for number in numbers], dtype=np.intp),
            proposed=np.zeros(len(numbers), dtype=np.bool_),
        )

    def _check_stop(self, number: int) -> None:
        arms, line = self.by_stop[number], self.first_line[number]
        for name in self._profile.arms:
            if STOP not in arms.get(name, {}):
                self._problems.add(line, "arm", f"configuration {number} has no row '{STOP}' of arm {name}; add it")
        legs = {int(point[3:]) for points in arms.values() for point in points if point.startswith("leg")}
        if legs and max(legs) != len(legs):
            missing = min(set(range(1, max(legs))) - legs)
            self._problems.add(
                line, "point", f"configuration {number} has no leg{missing}; number legs from 1, no gaps"
            )
        for column in _OF_STOP[1:]:  # each arm has a dwell of its own
            said = {points[STOP].of_stop.get(column) for points in arms.values() if STOP in points} - {None}
            if len(said) > 1:
                self._problems.add(line, column, f"the arms of configuration {number} have different values")
        source = self._agreed(number, "repeat_of")
        if source is not None and (source not in self.by_stop or source == number):
            text = f"configuration {number} repeats {source}, which is no other configuration of this file"
            self._problems.add(line, "repeat_of", text)

    def _agreed(self, number: int, column: str) -> int | None:
        """Return the value that the rows of a stop agree on; None if it is not given."""
        said = (points[STOP].of_stop.get(column) for points in self.by_stop[number].values() if STOP in points)
        return next((one for one in said if one is not None), None)

    def _legs(self, number: int) -> tuple[Configuration, ...]:
        arms = self.by_stop[number]
        legs = []
        for leg in range(1, 1000):
            rows = {name: arms[name][f"leg{leg}"].q for name in self._profile.arms if f"leg{leg}" in arms[name]}
            if not rows:
                break
            legs.append(rows)
        return tuple(legs)


def _approach(points: Mapping[str, _PlanPoint]) -> Array:
    """Return where the last motion of an arm begins (N,); NaN if it is not planned."""
    return points[APPROACH].q if APPROACH in points else np.full_like(points[STOP].q, np.nan)
