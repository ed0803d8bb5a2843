"""Rounds of blind trials of planned stops, at sizes that earlier trials suggest, and their joint result.

One trial hides an effect of a given size in an arm, measures the planned stops, and searches. The law is one of the
simulated cell, of another shape than the library's if there is one. Its SMR displacements are scaled to the requested
size, so that the sizes of all effects are comparable and a law keeps its shape.

``trials power``: from which size on effects would be named.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import PlannedStops, last_motions, stop_times_of, without_reserves
from cellapp.cell.planning.view import required_plan
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.trials.blind import beyond_geometry, conditions_at, readings_at, registered_model, with_hidden
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.table import Interval, Table, table_of
from cellapp.estimation.calibration.calibrate import calibrate_arm, profile_splits, rms_length_mm
from cellapp.estimation.calibration.quantities import ArmReadings, conditions_of_arms
from cellapp.estimation.discovery.arm_data import UNKNOWN
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.readings import Readings
from cellapp.estimation.uncertainty.detection_curve import NamingCurve
from cellapp.ground.counting import counted
from cellapp.ground.executors import PoolWork, TimeLimit, gather, local_cores
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Plant as PlantSection
from cellapp.ground.progress import Notice
from cellapp.ground.results import Record, Result
from cellapp.ground.version import __version__
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.transforms import Array, quaternions_of, rms_length, rotation_vectors
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import OFF_AXIS
from drivers.plant import REALISTIC, Plant, suggest_other_law
from drivers.plant.plant import Conditions

_JOINT_RISE_K, _WARM_UP_S = 10.0, 3000.0
"""Final temperature of joints above the air [K], and its time constant [s]."""
_AIR_K, _AIR_PERIOD_S = 1.0, 1.5e4
"""Amplitude [K] and period [s] of the air's temperature."""
_STILL_M = 1e-9
"""An effect of realistic size that moves the SMR by less [m] does not act at these stops."""

Rows = tuple[tuple[float, ...], ...]


class PlannedCell(Record):
    """What all trials share: the profile and its planned stops.

    ``q`` and ``step`` are arm -> joint positions and last motions (n, N) [rad], ``time_s`` and ``dwell_s`` (n,) [s].
    """

    profile: Profile
    q: Mapping[str, Rows]
    step: Mapping[str, Rows]
    time_s: tuple[float, ...]
    dwell_s: tuple[float, ...]

    @classmethod
    def of(cls, profile: Profile, stops: PlannedStops) -> PlannedCell:
        """Return the cell of a profile at the stops of a plan, reserves left out."""
        visited = without_reserves(profile, stops)
        times = stop_times_of(profile, visited)
        return cls(
            profile=profile,
            q={name: _rows(q) for name, q in visited.q.items()},
            step={name: _rows(step) for name, step in last_motions(visited, home_positions(profile)).items()},
            time_s=tuple(times.measured_s.tolist()),
            dwell_s=tuple(times.resting_s.tolist()),
        )


@dataclass(frozen=True, eq=False)
class TrialCell:
    """A cell whose plan is tried.

    Attributes
    ----------
    profile, simulated : Profile
        The profile for evaluation, and the simulated one: without effects, with masses and geometry of a typical arm.
    conditions : mapping
        Arm -> conditions of its planned stops.
    readings : mapping
        Arm -> readings of the published arm, without noise; each trial replaces their points.
    """

    profile: Profile
    simulated: Profile
    conditions: Mapping[str, Conditions]
    readings: Mapping[str, Readings]

    @cached_property
    def models(self) -> dict[str, ArmModel]:
        """Published arms, registered to their readings: needed for effects that depend on the other arms."""
        return {name: registered_model(self.profile, name, own.q, own.p_M) for name, own in self.readings.items()}

    def noise_rms_mm(self, name: str) -> float:
        """Return the rms length of the tracker's noise at the stops of an arm [mm]."""
        covariance = self.readings[name].covariance_M
        assert covariance is not None
        return rms_length_mm(covariance)


def trial_cell(planned: PlannedCell) -> TrialCell:
    """Prepare a cell. Raises ``InputError`` if the profile does not give the poses of arms and tracker."""
    simulated = _simulated(planned.profile)
    plant = build_plant(simulated)
    time_s, dwell_s = np.array(planned.time_s), np.array(planned.dwell_s)
    q = {name: np.array(rows) for name, rows in planned.q.items()}
    air_c = plant.config.temperature_c + _AIR_K * np.sin(2.0 * np.pi * time_s / _AIR_PERIOD_S)
    warm_c = air_c - _JOINT_RISE_K * np.expm1(-time_s / _WARM_UP_S)
    conditions: dict[str, Conditions] = {}
    readings: dict[str, Readings] = {}
    for name, own in q.items():
        step = np.array(planned.step[name])
        load = np.full(len(own), planned.profile.arms[name].payload.mass)
        joints_c = np.repeat(warm_c[:, None], own.shape[1], axis=1)
        conditions[name] = conditions_at(name, q, step, time_s, dwell_s, load, joints_c, air_c)
        exact = plant.smr_positions(name, own, **conditions[name])
        covariance = plant.measure_positions(exact, np.random.default_rng(0))[1]
        readings[name] = readings_at(own, conditions[name], exact, covariance)
    return TrialCell(planned.profile, simulated, conditions, readings)


def naming_trial(cell: TrialCell, asked: NamingTrial) -> NamingTrial:
    """Hide the effect, measure, calibrate and search; return the trial with the findings."""
    rng = np.random.default_rng([asked.seed, 0xB0E2])
    name = asked.arm
    true_arms = int(rng.integers(2**31))
    plant = build_plant(with_hidden(cell.simulated, {}, true_arms))
    config = next(arm for arm in plant.config.arms if arm.name == name)
    duration_s = float(cell.readings[name].time_s[-1])
    law: Mapping[str, Any] = suggest_other_law(asked.effect, rng, config, duration_s)
    hidden = build_plant(with_hidden(cell.simulated, {name: {asked.effect: law}}, true_arms))
    measured = _measured(cell, name, plant, hidden, 1e-3 * asked.size_mm, rng)
    return asked if measured is None else _searched(cell, asked, *measured)


# -- inside -----------------------------------------------------------------------------------------------------------


def _rows(values: Array) -> Rows:
    return tuple(tuple(row) for row in values.tolist())


def _simulated(profile: Profile) -> Profile:
    """Return the profile with a simulated cell: that of its section ``plant``, or a typical one."""
    plant = (profile.plant or PlantSection()).model_copy(update={"effects": {}, "noise": True})
    arms = {
        name: arm
        if arm.smr.offset != "unknown"
        else arm.model_copy(update={"smr": arm.smr.model_copy(update={"offset": tuple(OFF_AXIS.tolist())})})
        for name, arm in profile.arms.items()
    }
    return profile.model_copy(update={"plant": plant, "arms": arms})


def _measured(
    cell: TrialCell, name: str, plant: Plant, hidden: Plant, size_m: float, rng: np.random.Generator
) -> tuple[Readings, float] | None:
    """Simulate readings of an arm with an effect of a size [m]; also return the share of it that geometry cannot
    absorb.

    None if the effect does not act at these stops.
    """
    own, conditions = cell.readings[name], cell.conditions[name]
    scatter = 0.0 if cell.simulated.plant is None else cell.simulated.plant.repeatability
    stopped = own.q + scatter * rng.standard_normal(own.q.shape)
    exact = plant.smr_positions(name, stopped, **conditions)
    moved = hidden.smr_positions(name, stopped, **conditions) - exact
    rms_m = rms_length(moved)
    if rms_m < _STILL_M:
        return None
    scale = size_m / rms_m
    points, covariance = plant.measure_positions(exact + scale * moved, rng)
    further: dict[str, Any] = {}
    if (probe := cell.profile.arms[name].smr.probe) is not None:
        before = plant.probe_rotations(name, stopped, **conditions)
        rotated = rotation_vectors(hidden.probe_rotations(name, stopped, **conditions) @ before.swapaxes(1, 2))
        error = Rotation.from_rotvec(scale * rotated + probe.sigma * rng.standard_normal(moved.shape))
        quaternion = quaternions_of(error.as_matrix() @ before)
        further = {"quaternion_M": quaternion, "sigma_rad": np.full(len(moved), probe.sigma)}
    visible = rms_length(beyond_geometry(cell.profile.arms[name], stopped, exact, moved)) / rms_m
    return replace(own, p_M=points, covariance_M=covariance, **further), visible


def _searched(cell: TrialCell, asked: NamingTrial, readings: Readings, visible: float) -> NamingTrial:
    """Return the trial with what calibration and search accept."""
    name = asked.arm
    profile = cell.profile.model_copy(update={"seed": asked.seed})
    splits, _ = profile_splits(profile, cell.readings)  # by the stops, independent of the measurements
    own = replace(readings, split=splits[name])
    model = calibrate_arm(profile, name, own)[0].model
    measured = ArmReadings.of_cell(profile, {**cell.models, name: model}, {**cell.readings, name: own})
    accepted = discover_arm(measured[name]).result.accepted
    return asked.model_copy(update={"visible": visible, "accepted": tuple(one.effect for one in accepted)})


_FIRST = (0.5, 1.0, 2.0, 4.0)
"""Sizes of the first trials, in rms lengths of the tracker's noise."""
_LOWEST, _HIGHEST = 0.2, 40.0
"""Range of sizes, in the same unit: 0.005 to 1 mm with a common tracker."""
_LIMITS = (0.05, 0.5, 0.95)
_ENOUGH = 8
"""Trials after which an effect that was never named is given up."""
_FOLLOWED = 0.3
"""Share absorbed by geometry from which that is stated as the limit of naming."""


def detectability_at(where: Path, trials: int, seed: int, work: PoolWork, limit: TimeLimit) -> DetectabilityResult:
    """Try the stops that a profile would plan, or those that are planned in a run, which keeps the result.

    Raises as ``make_stops`` and ``plan_detects`` do, and ``InputError`` if the run has no plan.
    """
    if not where.is_dir():
        profile = load_profile(where)
        stops, _ = make_stops(profile, work.job)
        return plan_detects(PlannedCell.of(profile, stops), trials, seed, work, limit)
    with RunFile.open(where, write=True) as run:
        result = plan_detects(PlannedCell.of(run.profile, required_plan(run)), trials, seed, work, limit)
        run.write_document(DETECTABILITY_RESULT, result.to_json())
        return result


def plan_detects(planned: PlannedCell, trials: int, seed: int, work: PoolWork, limit: TimeLimit) -> DetectabilityResult:
    """Make ``trials`` trials of each effect in each arm, in rounds; ``seed`` samples them all.

    The time limit is shared among the effects; the intervals state the remaining uncertainty.

    Raises
    ------
    InputError
        If the profile does not describe the cell.
    Cancelled
        On request; a results file keeps the trials that were made.
    """
    cell = trial_cell(planned)
    lacking = _lacking(cell)
    tried = [
        _TriedSize(arm, effect, seed, cell.noise_rms_mm(arm)) for (arm, effect), reason in lacking.items() if not reason
    ]
    failed: list[str] = []
    allowed = work.jobs or local_cores()  # the first trials show their duration
    work.job.tell("power", 0, 0, detail=Notice(f"takes {limit.words()}; more trials narrow the intervals"))
    while asked := _round(tried, trials)[:allowed]:
        began_s = limit.now()
        begun = any(one.trials for one in tried)
        given = {f"arm {one.arm}, {one.effect}, {one.size_mm:.3f} mm, seed {one.seed}": one for one in asked}
        prepare = partial(trial_cell, planned)
        gathered = gather(naming_trial, prepare, given, NamingTrial, "power", work, all_may_fail=begun)
        failed += gathered.failed
        tried = [one.with_trials(asked, gathered.results) for one in tried]
        allowed = limit.allowed((limit.now() - began_s) / len(asked), 2 * len(tried))
    sizes = {(one.arm, one.effect): one.detectability() for one in tried}
    return DetectabilityResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        profile=planned.profile.name,
        trials_of_each=trials,
        seed=seed,
        share=SHARE,
        arms={
            name: ArmDetectability(
                stops=len(planned.time_s),
                noise_rms_mm=cell.noise_rms_mm(name),
                effects=tuple(
                    sizes.get((arm, effect), Detectability(effect=effect, title=EFFECTS[effect].title, limit=reason))
                    for (arm, effect), reason in lacking.items()
                    if arm == name
                ),
            )
            for name in planned.q
        },
        trials=tuple(trial for one in tried for trial in one.trials),
        failed=tuple(failed),
        ended_by_time=bool(_round(tried, trials)),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TriedSize:
    """One effect in one arm and its trials so far; ``noise_mm`` is the rms length of the noise.

    ``failed`` counts trials that could not be computed: they are not repeated.
    """

    arm: str
    effect: str
    seed: int
    noise_mm: float
    trials: tuple[NamingTrial, ...] = ()
    failed: int = 0

    @property
    def belief(self) -> NamingCurve:
        """Estimate of the share that is named, over the size [mm]."""
        sizes = [trial.size_mm for trial in self.trials]
        named = [trial.named for trial in self.trials]
        return NamingCurve.of(_LOWEST * self.noise_mm, _HIGHEST * self.noise_mm, sizes, named)

    @property
    def is_hopeless(self) -> bool:
        """Whether enough trials at large sizes named nothing, or the effect does not act at these stops."""
        acts = not self.trials or any(trial.visible for trial in self.trials)
        return not acts or (len(self.trials) >= _ENOUGH and not any(trial.named for trial in self.trials))

    def next_trials(self, most: int) -> Iterator[NamingTrial]:
        """Yield the trials of the next round, at most up to ``most`` in all."""
        if self.is_hopeless:
            return
        made = len(self.trials) + self.failed
        sizes = [size * self.noise_mm for size in _FIRST[made:]] or self.belief.next_sizes(SHARE)
        for place, size in enumerate(sizes[: most - made], start=made):
            rng = np.random.default_rng([self.seed, place, *f"{self.arm} {self.effect}".encode()])
            yield NamingTrial(arm=self.arm, effect=self.effect, size_mm=size, seed=int(rng.integers(2**31)))

    def with_trials(self, asked: Sequence[NamingTrial], found: Sequence[NamingTrial | None]) -> _TriedSize:
        """Add those of the trials ``asked`` that are of this effect and arm; the result of a failed one is None."""
        own = [
            result
            for trial, result in zip(asked, found, strict=True)
            if (trial.arm, trial.effect) == (self.arm, self.effect)
        ]
        done = [result for result in own if result is not None]
        return replace(self, trials=(*self.trials, *done), failed=self.failed + len(own) - len(done))

    def detectability(self) -> Detectability:
        """Summarize the trials."""
        low, middle, high = self.belief.size_at(SHARE, _LIMITS)
        largest = max((trial.size_mm for trial in self.trials), default=0.0)
        shown = middle <= largest and any(trial.named for trial in self.trials)
        named = [trial for trial in self.trials if trial.named]
        return Detectability(
            effect=self.effect,
            title=EFFECTS[self.effect].title,
            named_from=NamedSize(value_mm=middle, low_mm=low, high_mm=high if np.isfinite(high) else None)
            if shown
            else None,
            not_up_to_mm=None if shown or not largest else largest,
            visible_share=float(np.median([trial.visible for trial in self.trials])) if self.trials else None,
            trials=len(self.trials),
            named=len(named),
            with_others=sum(len(set(trial.accepted)) > 1 for trial in named),
            limit=_limit(self.trials, 0.5 * middle if shown else 0.25 * largest)
            if self.trials
            else ("no trial could be computed" if self.failed else "not tried: the time ended before"),
        )


def _round(tried: Sequence[_TriedSize], most: int) -> list[NamingTrial]:
    """Return the next trials, the first of each effect before the second of any; at most ``most`` of each."""
    each = [list(one.next_trials(most)) for one in tried]
    return [trial for together in zip_longest(*each) for trial in together if trial is not None]


def _lacking(cell: TrialCell) -> dict[tuple[str, str], str]:
    """Return (arm, effect) -> why its data cannot show it, for effects that cannot be shown."""
    conditions = conditions_of_arms(cell.models, cell.readings)
    return {
        (name, slug): EFFECTS[slug].missing_data(model.context(cell.readings[name].q, conditions=conditions[name]))
        for name, model in cell.models.items()
        for slug in REALISTIC
        if slug in EFFECTS
    }


def _limit(trials: Sequence[NamingTrial], from_mm: float) -> str:
    """Say what limits naming, from the trials with sizes from ``from_mm`` [mm] on."""
    if not any(trial.visible for trial in trials):
        return "it does not move the SMR at these stops"
    said = []
    followed = 1.0 - float(np.median([trial.visible for trial in trials]))
    if followed > _FOLLOWED:
        said.append(f"geometry follows {followed:.0%} of it")
    missed = [trial for trial in trials if trial.size_mm >= from_mm and not trial.named]
    instead = Counter(_name(slug) for trial in missed for slug in dict.fromkeys(trial.accepted))
    for name, count in instead.most_common(1):
        said.append(f"taken for {name} in {count} of {len(missed)} misses")
    nothing = sum(not trial.accepted for trial in missed)
    if nothing:
        said.append(f"nothing accepted in {nothing} of {len(missed)} misses")
    return "; ".join(said) or "noise"


def _name(slug: str) -> str:
    return "an unknown effect" if slug == UNKNOWN else EFFECTS[slug].title.lower()


DETECTABILITY_RESULT = "plan-power"
"""Name of the document in a run with the result."""
SHARE = 0.95
"""Share of the trials in which an effect must be named."""


class NamingTrial(Record):
    """One blind trial: an effect hidden in an arm, its rms displacement of the SMR, and what was accepted.

    ``visible`` is the share of the displacement that the geometry cannot follow.
    """

    arm: str
    effect: str
    size_mm: float
    seed: int
    visible: float = 0.0
    accepted: tuple[str, ...] = ()

    @property
    def named(self) -> bool:
        """Whether the effect was named."""
        return self.effect in self.accepted


class NamedSize(Record):
    """Rms displacement of the SMR [mm] from which an effect is named in ``SHARE`` of the trials: median of the belief,
    and the limits of 90 %; ``high_mm`` is None where the trials set none."""

    value_mm: float
    low_mm: float
    high_mm: float | None


class Detectability(Record):
    """What the trials say of one effect in one arm.

    Attributes
    ----------
    named_from : NamedSize or None
        None: the trials do not show that it would be named in ``SHARE`` of the runs, whatever its size.
    not_up_to_mm : float or None
        Then the largest rms displacement that was tried [mm]; None where no trial was made.
    visible_share : float or None
        Median share of its displacement that geometry cannot follow at these stops.
    trials, named, with_others : int
        Trials, those in which its name was accepted, and those of them in which another name was, too.
    limit : str
        What limits it.
    """

    effect: str
    title: str
    named_from: NamedSize | None = None
    not_up_to_mm: float | None = None
    visible_share: float | None = None
    trials: int = 0
    named: int = 0
    with_others: int = 0
    limit: str = ""


class ArmDetectability(Record):
    """One arm: stops, rms length of the tracker's noise [mm], and every effect of the library that it can have."""

    stops: int
    noise_rms_mm: float
    effects: tuple[Detectability, ...]


class DetectabilityResult(Result, schema="cellapp-plan-power"):
    """``trials power``: arms, every trial, what failed, and whether the time ended it before all trials were made."""

    date: str
    program: str
    profile: str
    trials_of_each: int
    seed: int
    share: float
    arms: Mapping[str, ArmDetectability]
    trials: tuple[NamingTrial, ...]
    failed: tuple[str, ...] = ()
    ended_by_time: bool = False


def stored_detectability(run: RunFile) -> DetectabilityResult | None:
    """Return the stored result of a run; None if its plan was not tried."""
    text = run.read_document(DETECTABILITY_RESULT)
    return None if text is None else DetectabilityResult.from_json(text, str(run.folder))


def detectability_parts(result: DetectabilityResult) -> Parts:
    """Show what the plan would name: the method, then a table for each arm."""
    tables = [detectability_table(name, arm) for name, arm in result.arms.items()]
    return [detectability_sentence(result), *tables, *(f"not computed: {one}" for one in result.failed[:10])]


def detectability_sentence(result: DetectabilityResult) -> str:
    """Say what was tried, in one sentence."""
    ended = f"; the time ended them before all {result.trials_of_each} of each" if result.ended_by_time else ""
    return (
        f"Sizes from which an effect is named in {result.share:.0%} of the runs, from {len(result.trials)} blind trials"
        f" of the planned stops with the tracker's noise (seed {result.seed}{ended}); the interval holds with 90 %."
    )


def detectability_table(name: str, arm: ArmDetectability) -> Table:
    """Show every effect of an arm; those named from the smallest sizes first."""
    return table_of(
        f"Arm {name}: {counted(arm.stops, 'stop')}, noise {arm.noise_rms_mm:.3f} mm rms",
        _ordered(arm),
        ("effect", lambda one: one.title),
        ("named from", lambda one: one.named_from and one.named_from.value_mm, ".3f", "mm rms"),
        ("interval", _interval, ".3f", "mm rms"),
        ("not up to", lambda one: one.not_up_to_mm, ".2f", "mm rms"),
        ("trials", lambda one: one.trials, "d"),
        ("named", lambda one: one.named, "d"),
        ("with another name", lambda one: one.with_others, "d"),
        ("what limits it", lambda one: one.limit),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _ordered(arm: ArmDetectability) -> list[Detectability]:
    return sorted(arm.effects, key=lambda one: math.inf if one.named_from is None else one.named_from.value_mm)


def _interval(one: Detectability) -> Interval | str | None:
    if one.named_from is None:
        return None
    low, high = one.named_from.low_mm, one.named_from.high_mm
    return f"{low:.3f} and more" if high is None else Interval(low, high)
