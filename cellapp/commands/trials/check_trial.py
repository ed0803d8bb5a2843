"""How often the ten-minute check finds and names changes of simulated cells, and how often it gives a false alarm.

A cell is drawn and calibrated from many stops. Then the plant is changed, not the model: each visible parameter of
the geometry by 0.05 mm or 50 µrad, one at a time; stiffness, play and eccentricity of joints so that the SMR moves by
0.05 mm; tracker, bases and SMRs by 0.1 to 10 mm. Each check measures the chosen stops with its own noise.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.trials.check_changes import PlantChange, effect_changes, parameter_plant, rigid_changes
from cellapp.commands.trials.check_records import CheckedChange, CheckTrialResult
from cellapp.commands.trials.drawn_cell import calibrated_alone, drawn_cell, measured_stops, require_simulated
from cellapp.commands.trials.measured import measured_by
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.estimation.monitoring.check import CheckBelief, check_belief, choose_stops
from cellapp.estimation.monitoring.check.conclusion import judgement
from cellapp.estimation.monitoring.check.linear import Moments, StopRows, stop_rows
from cellapp.estimation.monitoring.check.model import FALSE_ALARM, LENGTH_M, TRACKER, TURN_RAD
from cellapp.estimation.monitoring.check.naming import Cause, Design, with_station
from cellapp.estimation.monitoring.check.sequential import decided_prefix, design_of
from cellapp.estimation.monitoring.check.statistics import MinPValueTest
from cellapp.estimation.prior.belief import is_own
from cellapp.estimation.prior.changes import parameter_words
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record
from cellapp.ground.scale.task import Seed, TaskKind, as_given
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array, apply
from cellapp.robot.model import CellModel
from drivers.plant import Plant

_RIGID_M = (1e-4, 1e-3, 1e-2)
"""Motions of tracker, bases and SMRs [m, rad]."""
_CHANGE_SEED = 0xC4A6
"""Added to the seed of a cell, so that the draw of changes is independent of all other draws."""
_NOISE_SEED = 10_000
"""Factor on the seed of a cell, so that no two checks have the same noise."""
_PLANS, _NEXT_PLAN = 4, 100_000
"""Most plans that are tried, and the step of the seed between them: one seed in some hundred finds no path."""


class CheckPlan(Record):
    """What the checks of all cells share: stops of the calibration and of a check, and checks of a cell as it was.

    ``mix`` hides other effects than the profile's.
    """

    profile: Profile
    earlier: int = 400
    planned: int = 20
    unchanged: int = 20
    mix: bool = False
    station_free: bool = False


class CheckedCell(Record):
    """The outcome of one cell: its checks, and the least non-centrality of a visible change in ``weakest``."""

    seed: int
    checks: tuple[CheckedChange, ...]
    weakest: tuple[str, float]


def check_trials(
    plan: CheckPlan,
    seeds: Sequence[int],
    work: Work = IN_PLACE,
) -> CheckTrialResult:
    """Check simulated cells, one for each seed.

    Raises
    ------
    InputError
        If the profile has no plant.
    Cancelled
        On request.
    """
    require_simulated(plan.profile)
    gathered = work.gather(CELLS, "check", plan, [Seed(seed=seed) for seed in seeds])
    found = gathered.found
    return CheckTrialResult(
        profile=drawn_cell(plan.profile, found[0].seed, mix=plan.mix).name,
        cells=len(found),
        planned=plan.planned,
        station_free=plan.station_free,
        weakest={f"{one.seed}: {one.weakest[0]}": one.weakest[1] for one in found},
        checks=tuple(check for one in found for check in one.checks),
        failed=gathered.failed,
    )


def checked_cell(plan: CheckPlan, drawn: Seed) -> CheckedCell:
    """Calibrate one cell and check it after each change."""
    seed = drawn.seed
    profile = drawn_cell(plan.profile, seed, mix=plan.mix)
    known = _calibration_readings(profile, plan.earlier, seed)
    model = CellModel(calibrated_alone(profile, known))
    belief = check_belief(profile, model, known, station_free=plan.station_free)
    homes = home_positions(profile)
    chosen = choose_stops(belief, {name: its.q for name, its in known.items()}, plan.planned, start=homes)
    q = {name: its.q[chosen.order] for name, its in known.items()}
    trial = _Trial(profile, design_of(belief), q, homes, seed)
    weakest = chosen.weakest
    return CheckedCell(
        seed=seed,
        checks=tuple(trial.check(number, change) for number, change in enumerate(trial.changes(plan.unchanged))),
        weakest=("", 0.0) if weakest is None else (f"{weakest.what} {weakest.arm}", weakest.noncentrality),
    )


CELLS = TaskKind("cellapp.commands.trials.check_trial:CELLS", CheckPlan, Seed, CheckedCell, as_given, checked_cell)


def _calibration_readings(profile: Profile, stops: int, seed: int) -> dict[str, Readings]:
    """Simulate readings at a plan of the cell's own; try another seed if the planner finds too few stops."""
    for number in range(_PLANS - 1):
        with contextlib.suppress(InputError):
            return measured_stops(profile, stops, seed + _NEXT_PLAN * number)
    return measured_stops(profile, stops, seed + _NEXT_PLAN * (_PLANS - 1))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A calibrated cell whose checks stop at ``q``, arm -> (n, N) [rad]."""

    profile: Profile
    design: Design
    q: Mapping[str, Array]
    homes: Mapping[str, Array]
    seed: int

    @cached_property
    def before(self) -> Array:
        """Positions (m, 3) [m] of all SMRs at the stops before any change, without noise."""
        return self.points(build_plant(self.profile))

    @cached_property
    def last(self) -> MinPValueTest:
        """The test after all stops; it depends on the stops only, not on their measurements."""
        readings = self._readings(build_plant(self.profile), 0)
        stops = stop_rows(self.belief, readings, self.design.directions)
        return MinPValueTest.of(Moments.of(stops), self.design.alternatives)

    @property
    def belief(self) -> CheckBelief:
        return self.design.belief

    def changes(self, unchanged: int) -> Iterator[PlantChange]:
        """Yield the unchanged cell, several times, then the cell with each change."""
        before = build_plant(self.profile)
        for _ in range(unchanged):
            yield PlantChange("unchanged", "", "", before)
        rng = np.random.default_rng([self.seed, _CHANGE_SEED])
        for arm, its in self.belief.arms.items():
            joints = its.model.geometry.joints
            for column in its.columns:
                name = parameter_names(joints)[column]
                if is_own(column, joints):
                    size = float(rng.choice([-1.0, 1.0])) * (LENGTH_M if parameter_unit(name) == "m" else TURN_RAD)
                    yield PlantChange("parameter", arm, name, parameter_plant(self.profile, arm, name, size))
        yield from effect_changes(self.profile, LENGTH_M, self.points)
        yield from rigid_changes(self.profile, _RIGID_M, rng)

    def points(self, plant: Plant) -> Array:
        """Compute the positions (m, 3) [m] of all SMRs at the stops, arm by arm, without noise."""
        exact = measured_by(plant, self.homes, self.q, 0, noise=False)
        return np.concatenate([its.p_M for its in exact.values()])

    def check(self, number: int, change: PlantChange) -> CheckedChange:
        """Check a changed plant once."""
        readings = self._readings(change.plant, number)
        stops = stop_rows(self.belief, readings, self.design.directions)
        some, state = decided_prefix(self.design, stops)
        here, _ = with_station(self.design, some)
        verdict, found, _, _ = judgement(self.design, here, state)
        moved = self.points(change.plant) - self.before
        count = len(stops.measured) / (1 if change.arm in ("", TRACKER) else len(self.q))
        what, visible = self._words(change)
        first = found.causes[0] if found.causes else None
        named = first is not None and (first.alternative.arm, self.design.name_of(first.alternative)) == (
            change.arm,
            what,
        )
        moments = Moments.of(with_station(self.design, stops)[0])
        p_values = self.last.p_values(moments.white[:, None])[:, 0]
        return CheckedChange(
            seed=self.seed,
            group=change.group,
            arm=change.arm,
            what=what,
            visible=visible,
            moved_mm=float(np.sqrt(np.sum(moved**2) / count)) * 1e3,
            verdict=verdict,
            stops=state.stops,
            named=named,
            listed=named or (first is not None and what in first.rivals),
            solved_mm=None if first is None or not named else _solved_mm(self.design, change, first, stops),
            by_chi_squared=float(p_values[-1]) <= FALSE_ALARM,
            by_directions=self.last.significant(float(p_values.min()), FALSE_ALARM),
        )

    def _readings(self, plant: Plant, number: int) -> dict[str, Readings]:
        return measured_by(plant, self.homes, self.q, _NOISE_SEED * (self.seed + 1) + number)

    def _words(self, change: PlantChange) -> tuple[str, bool]:
        """Return the name of a change in the check, and whether it is visible."""
        if change.group == "unchanged":
            return "", False
        if change.group in ("parameter", "effect"):
            what = words_of(change)
            places = [k for k, one in enumerate(self.design.directions) if (one.arm, one.what) == (change.arm, what)]
            its = what if len(self.q) == 1 else f"{what}, arm {change.arm}"
            return its, bool(np.any(self.design.visible[places]))
        return change.what, change.group != "tracker" or not self.belief.station_free


def words_of(change: PlantChange) -> str:
    """Return the name of a change of a parameter or effect in the check."""
    if change.group == "parameter":
        return parameter_words(change.what)
    slug, joint = change.what.split()
    return f"{EFFECTS[slug].title}, joint {joint}"


def _solved_mm(design: Design, change: PlantChange, cause: Cause, stops: StopRows) -> float | None:
    """Return the largest error [mm] of a solved motion at the points that it moves; None without a motion."""
    if change.motion is None or cause.motion is None:
        return None
    names = list(design.belief.arms)
    p_M = stops.expected if change.arm == TRACKER else stops.expected[stops.arm_of == names.index(change.arm)]
    off = apply(cause.motion, p_M) - apply(change.motion, p_M)
    return float(np.linalg.norm(off, axis=1).max()) * 1e3
