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

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellapp.cell.planning.planned_stops import LONGEST_DWELL_S, Configuration, PlannedStops, straight_stops
from cellapp.cell.run.csv_text import CsvTable, Problems, read_csv_table, short, write_csv
from cellapp.cell.run.table_spec import ArmCells, TableSpec
from cellapp.estimation.readings.columns import Column
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

STOP, APPROACH = "stop", "approach"
_POINT = re.compile(r"stop|approach|leg([1-9][0-9]{0,2})")
_KEYS = ("configuration", "arm", "point")
_OF_STOP = ("dwell_s", "block", "repeat_of", "frozen", "load")
_PLANS = TableSpec(
    (
        *(Column(name, "", (name,), required=True) for name in _KEYS),
        Column("q", "rad", ("q",), "joints", required=True),
        *(Column(name, "", (name,)) for name in _OF_STOP),
    )
)
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
    _check_header(table, max(len(arm.type.joints) for arm in profile.arms.values()), problems)
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


def _check_header(table: CsvTable, joints: int, problems: Problems) -> None:
    for name, _ in _PLANS.missing(table.names, joints):
        problems.add(1, name, "the column is missing")
    known = _PLANS.names(joints)
    for name in table.names:
        if name not in known:
            hint = did_you_mean(name, known, "is '{}' meant?", otherwise=f"columns are {', '.join(known)}")
            problems.add(1, name, f"the column is unknown; {hint}")
    problems.check()


class _Points:
    """The rows of a file by configuration, arm and point; errors are collected in ``problems``."""

    def __init__(self, table: CsvTable, profile: Profile, problems: Problems) -> None:
        self._profile, self._problems = profile, problems
        self._cells = cells = ArmCells(table, range(len(table.lines)), problems, every=True)
        self.by_stop: dict[int, dict[str, dict[str, int]]] = {}
        self.first_line: dict[int, int] = {}
        self._q: dict[int, Array] = {}
        self._of_stop: dict[str, dict[int, Any]] = {name: {} for name in _OF_STOP}
        numbers = cells.whole_numbers("configuration", least=0).tolist()
        arms, points = ([cell.strip() for cell in cells.texts(name)] for name in ("arm", "point"))
        for row, (arm, point) in enumerate(zip(arms, points, strict=True)):
            if arm not in profile.arms:
                what = f"arm '{short(arm)}' is not in the profile" if arm else "the value is missing"
                cells.refuse(row, "arm", f"{what}; arms are {', '.join(profile.arms)}")
            if not _POINT.fullmatch(point):
                cells.refuse(row, "point", f"expected leg1, leg2, ..., approach or stop, got '{short(point)}'")
        keyed = self._sound(cells.rows)
        for arm in profile.arms:
            own = [row for row in keyed if arms[row] == arm]
            self._read_joints(arm, replace(cells, rows=own))
            for name in (name for name in _OF_STOP if name in table.cells):
                self._read_of_stop(name, [row for row in own if table.cells[name][row].strip()], points)
        for row in self._sound(keyed):
            number, arm, point = numbers[row], arms[row], points[row]
            self.first_line.setdefault(number, cells.line(row))
            first = self.by_stop.setdefault(number, {}).setdefault(arm, {}).setdefault(point, row)
            if first != row:
                text = f"{number} of arm {arm} has a row '{point}' in line {cells.line(first)} already; keep one"
                cells.refuse(row, "configuration", text)

    # -- rows ----------------------------------------------------------------------------------------------------------

    def _sound(self, rows: Sequence[int]) -> list[int]:
        """Return those of the rows in which nothing is wrong so far."""
        wrong = {line for line, _ in self._problems.found}
        return [row for row in rows if self._cells.line(row) not in wrong]

    def _read_joints(self, name: str, cells: ArmCells) -> None:
        limits, q = self._profile.arms[name].joint_limits, []
        for joint, (low, high) in enumerate(limits, start=1):
            q.append(values := cells.numbers(f"q{joint}", required=True))
            within = (low - _ROUNDING_RAD <= values) & (values <= high + _ROUNDING_RAD)
            for index in np.flatnonzero(~within).tolist():
                text = f"{values[index]:g} rad is outside the limits {low:g} to {high:g} rad of arm {name}"
                cells.refuse(index, f"q{joint}", text)
        for column in _PLANS.beyond(sorted(cells.table.names), len(limits)):
            for index, text in enumerate(cells.texts(column)):
                if text.strip():
                    cells.refuse(index, column, f"there is a value, but arm {name} has {len(limits)} joints")
        self._q |= zip(cells.rows, np.column_stack(q), strict=True)

    def _read_of_stop(self, column: str, rows: Sequence[int], points: Sequence[str]) -> None:
        """Parse the filled cells of an arm that describe a stop."""
        for row in rows:
            if points[row] != STOP:
                text = f"there is a value, but it belongs to the row '{STOP}' of this arm"
                self._cells.refuse(row, column, text)
        cells = replace(self._cells, rows=[row for row in rows if points[row] == STOP])
        if column == "frozen":
            texts = [text.strip() for text in cells.texts(column)]
            found = [_WORDS.get(text.lower()) for text in texts]
            cells.expect(column, texts, np.array([one is not None for one in found], dtype=np.bool_), "yes or no")
        elif column == "dwell_s":
            found = cells.numbers(column, required=True).tolist()
            for index in (index for index, one in enumerate(found) if not 0.0 <= one <= LONGEST_DWELL_S):
                cells.refuse(index, column, f"expected 0 to {LONGEST_DWELL_S:g} s, got {found[index]:g}")
        else:
            found, most = cells.whole_numbers(column, least=0).tolist(), self._profile.loads - 1
            for index in (index for index, one in enumerate(found) if column == "load" and one > most):
                text = f"there is no load {found[index]}; with arms.NAME.payloads there are 0 to {most}"
                cells.refuse(index, column, text)
        self._of_stop[column] |= zip(cells.rows, found, strict=True)

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
        repeats, dwells = [self._agreed(number, "repeat_of") for number in numbers], self._of_stop["dwell_s"]
        return PlannedStops(
            q={name: np.array([self._q[row[STOP]] for row in rows[name]]) for name in arms},
            approach_from={name: np.array([self._approach(row) for row in rows[name]]) for name in arms},
            dwell_s={name: np.array([dwells.get(row[STOP], 0.0) for row in rows[name]]) for name in arms},
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
            said = {self._of_stop[column].get(points[STOP]) for points in arms.values() if STOP in points} - {None}
            if len(said) > 1:
                self._problems.add(line, column, f"the arms of configuration {number} have different values")
        source = self._agreed(number, "repeat_of")
        if source is not None and (source not in self.by_stop or source == number):
            text = f"configuration {number} repeats {source}, which is no other configuration of this file"
            self._problems.add(line, "repeat_of", text)

    def _agreed(self, number: int, column: str) -> int | None:
        """Return the value that the rows of a stop agree on; None if it is not given."""
        said = self._of_stop[column]
        rows = (points[STOP] for points in self.by_stop[number].values() if STOP in points)
        return next((said[row] for row in rows if row in said), None)

    def _legs(self, number: int) -> tuple[Configuration, ...]:
        arms = self.by_stop[number]
        legs = []
        for leg in range(1, 1000):
            rows = {name: self._q[arms[name][f"leg{leg}"]] for name in self._profile.arms if f"leg{leg}" in arms[name]}
            if not rows:
                break
            legs.append(rows)
        return tuple(legs)

    def _approach(self, points: Mapping[str, int]) -> Array:
        """Return where the last motion of an arm begins (N,); NaN if it is not planned."""
        return self._q[points[APPROACH]] if APPROACH in points else np.full_like(self._q[points[STOP]], np.nan)
