"""Drive a few stops of a calibrated cell and measure all arms at each, until a sequential test is decided.

Every stop is approached and measured as in collecting. The SMRs are searched for around their predictions, because
base, tracker or SMR may have moved.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from cellapp.cell.driving.measuring import APART_M, MOST_MISSED, FoundPoint, SmrSearch
from cellapp.cell.driving.motion import MotionRefused, Mover, reading_of
from cellapp.cell.driving.target_visit import drive_to
from cellapp.cell.planning.planned_stops import tell_time, visits_s
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import clear_stops, visible_stops
from cellapp.estimation.monitoring.belief import SequentialState
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel
from drivers.arms.protocol import ArmState

AddStop = Callable[[Mapping[str, Readings]], SequentialState]
"""Function that adds one stop, arm -> its reading, and returns the state of the test, as ``SequentialTest.add``."""


@dataclass(frozen=True, eq=False)
class MeasuredStop:
    """Result of one stop: the point of each arm, the state of the test after it, the time when it was done.

    ``number`` is the index of the planned stop; ``time_s`` counts from the first motion [s].
    """

    number: int
    found: Mapping[str, FoundPoint]
    state: SequentialState
    time_s: float


@dataclass(eq=False)
class DrivenCheck:
    """Measurements of a check; ``lost`` are arms whose SMR is no longer found, ``seconds`` the total time [s]."""

    stops: list[MeasuredStop] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0


def drive_check(
    mover: Mover, model: CellModel, stops: Sequence[Mapping[str, Readings]], add: AddStop, excess_m: Mapping[str, float]
) -> DrivenCheck:
    """Visit the stops with all arms together until the test that ``add`` tells is sure, and go home.

    ``model`` is in the present tracker frame. ``stops`` are readings of the calibration, one of each arm, in the order
    of driving. ``excess_m`` is as in ``fit_station``.
    If the gate refuses a stop for all arms together, each goes there alone, with the others at home. Raise as
    ``moving_cell``, and ``HardwareError`` if no SMR is found.
    """
    profile, repeat = mover.profile, mover.profile.collection.repeat
    search = SmrSearch(model, mover, np.eye(4), excess_m, 1 if repeat.precision is None else repeat.times)
    checking = _Checking(stops, add, mover, search)
    seconds = visits_s(profile, [{name: its.q[0] for name, its in stop.items()} for stop in stops])
    tell_time(mover.control, "check", profile, seconds, 0, len(stops), "takes at most about")
    checking.visit_all()
    mover.go_home()
    checking.driven.seconds = checking.elapsed_s()
    return checking.driven


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Checking:
    stops: Sequence[Mapping[str, Readings]]
    add: AddStop
    mover: Mover
    search: SmrSearch
    driven: DrivenCheck = field(default_factory=DrivenCheck)
    _missed: Counter[str] = field(default_factory=Counter)

    def elapsed_s(self) -> float:
        """Time since the first motion [s]."""
        return self.mover.cell.clock.now_s() - self.mover.began_s

    def visit_all(self) -> None:
        """Visit the stops until the test is decided, or every arm is given up."""
        for number, stop in enumerate(self.stops):
            self.mover.hold()
            self.mover.slow_start(number)
            wanted = {name: q for name, q in stop.items() if name not in self.driven.lost}
            if not wanted:
                break
            self.mover.control.tell("check", number, len(self.stops), f"stop {number + 1}")
            if self._visit(number, wanted):
                break
        if not self.driven.stops:
            raise HardwareError(
                f"no SMR could be measured at any stop: {'; '.join(self.driven.notes)}. If the tracker was moved, run"
                " 'cellapp check DIR --tracker-moved' with --tracker-pose first"
            )

    def _visit(self, number: int, wanted: Mapping[str, Readings]) -> bool:
        """Measure the arms at one stop, together or else one by one; return whether the test is decided."""
        alone = [{name: its} for name, its in wanted.items()]
        for part in (wanted, *alone) if len(alone) > 1 else alone:
            try:
                decided = self._measure(number, self._drive(part))
            except MotionRefused as error:
                if len(part) == 1:
                    self.driven.notes.append(f"stop {number + 1}, arm {', '.join(part)}: {error}")
                continue
            if decided or part is wanted:
                return decided
        return False

    def _drive(self, wanted: Mapping[str, Readings]) -> dict[str, ArmState]:
        """Drive arms to readings of the calibration, with the last motion as then; else one of its direction."""
        q = {name: its.q[0] for name, its in wanted.items()}
        signs = {name: its.approach[0].astype(np.float64) for name, its in wanted.items()}
        steps = {name: np.nan_to_num(its.step[0]) for name, its in wanted.items() if its.step is not None}
        if len(steps) == len(wanted):
            with suppress(MotionRefused):
                return drive_to(self.mover, q, steps, 1.0)
        return drive_to(self.mover, q, signs)

    def _measure(self, number: int, states: Mapping[str, ArmState]) -> bool:
        """Measure the SMRs of arms that are at a stop together; return whether the test is decided then."""
        found = {name: point for name, state in states.items() if (point := self._find(name, state)) is not None}
        if not found:
            return False
        # arms that went to a stop one by one count as two stops: the other arm was at home
        count = len(self.driven.stops)
        rows = {}
        for name, one in found.items():  # no time: it would be far beyond the times of the calibration
            row = reading_of(one.point, one.conditions, sequence=float(count), temperature_c=one.point.temperature_c)
            rows[name] = row.at_stop(count)
        state = self.add(rows)
        self.driven.stops.append(MeasuredStop(number, found, state, self.elapsed_s()))
        return state.sure

    def _find(self, name: str, state: ArmState) -> FoundPoint | None:
        """Measure one SMR; give up an arm whose SMR is missed too often."""
        found = self.search.measure(name, state)
        if isinstance(found, FoundPoint):
            self._missed[name] = 0
            return found
        self.driven.notes.append(found)
        self._missed[name] += 1
        if self._missed[name] >= MOST_MISSED[any(one.arm == name for one in self.search.found)]:
            self.driven.lost.append(name)
            self.driven.notes.append(
                f"arm {name}: its SMR was not found at {counted(self._missed[name], 'stop')} in a row and is not"
                " looked for any more: look for a covered or missing SMR"
            )
        return None


# -- Stops at which a check can measure all arms together: stops of the calibration that are clear and visible --------


def check_candidates(profile: Profile, model: CellModel, readings: Mapping[str, Readings]) -> dict[str, Readings]:
    """Return readings of all arms, of which row k of all arms is one stop.

    They are those, where the model is known, at which the arms are clear of each other and of everything else, the
    tracker of ``model`` sees all SMRs, and no SMR can be mistaken for another. Readings that were not taken at common
    stops are paired at random.

    Raises
    ------
    InputError
        If no stop is left.
    """
    stops = _together({name: readings[name] for name in model.arms}, profile.seed)
    q = {name: its.q for name, its in stops.items()}
    bodies = cell_bodies(profile, model)
    usable = clear_stops(bodies, q) & visible_stops(bodies, q)
    p_M = {name: model.predict(name, its) for name, its in q.items()}
    for one, other in combinations(p_M, 2):
        usable &= np.linalg.norm(p_M[one] - p_M[other], axis=1) >= APART_M
    if not usable.any():
        raise InputError(
            f"profile {profile.name}: at no stop of the calibration's readings are all arms clear and in the tracker's"
            " sight; nothing was moved"
        )
    return {name: its.take(usable) for name, its in stops.items()}


def _together(readings: Mapping[str, Readings], seed: int) -> dict[str, Readings]:
    """Return the readings of all arms at the stops where all were measured; if there are none, random pairs."""
    numbers = [arm.configuration for arm in readings.values()]
    common = numbers[0]
    for one in numbers[1:]:
        common = np.intersect1d(common, one)
    if len(common):
        return {name: arm.take(np.isin(arm.configuration, common)) for name, arm in readings.items()}
    count = min(len(arm) for arm in readings.values())
    rng = np.random.default_rng([seed, 0xC4EC])
    paired = {name: arm.take(rng.permutation(len(arm))[:count]) for name, arm in readings.items()}
    return {name: replace(arm, configuration=np.arange(count)) for name, arm in paired.items()}
