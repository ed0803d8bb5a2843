"""Compensation judged on whole simulated cells: plan, collect, calibrate, discover, then measure new targets.

Every seed is another cell with other true arms and another mix of hidden effects. All verbs are the product's own, on
simulated devices; the cell continues from job to job. The run's profile states no more than that of a real cell: the
hidden effects are in the simulated cell only.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cellapp.cell.driving.cell import build_plant, open_cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.push import push
from cellapp.cell.planning.duration import planned_time
from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.prediction import spread_of
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.cell.targets.records import MeasuredTarget, VerifyResult
from cellapp.cell.targets.targets import Target
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.locate.result import LocateVerdict
from cellapp.commands.locate.run import locate_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.commands.trials.blind import with_hidden
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.trials.target_draws import draw_hidden, draw_pairs, draw_targets
from cellapp.commands.trials.target_records import (
    CALIBRATED,
    RELOCATED,
    ArmFigures,
    HiddenEffects,
    PairFigures,
    StateFigures,
    TargetTrial,
    TargetTrialsResult,
    mean_of,
)
from cellapp.estimation.calibration.inter_base_transform import distances
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.results import CALIBRATE, Record
from cellapp.ground.scale.task import Seed, TaskKind, as_given
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, rotation_z, transform, zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import pose_matrix
from drivers.plant import Plant

_FLOOR_SEED = 0xF100
"""Mixed with the trial's seed."""
_STATION_SEED = 0x57A7
"""Mixed with the trial's seed."""
_OTHER_TARGETS = 1000
"""Added to the trial's seed for the targets after the tracker has moved."""
_TURNED = (math.radians(8.0), math.radians(25.0))
"""Range of the angle about the cell's z axis from the old station to the new one: some steps to one side."""
_PACED_M, _PACED_RAD = 0.02, math.radians(0.4)
"""Standard deviation of each coordinate and angle of a station measured by pacing."""
_FLOOR_DRAWS = 5
"""Repeated measurements of each target: with 200 targets the mean is known to 1.5 %."""
_NORMAL_95 = 1.959964
"""Half-width of a 95 % interval of a normal variable [standard deviations]."""


class TargetsPlan(Record):
    """What all cells share: ``targets`` single targets an arm, ``pairs`` cooperative ones."""

    profile: Profile
    targets: int
    pairs: int


def target_trials(
    profile: Profile,
    seeds: Sequence[int],
    targets: int,
    pairs: int,
    work: Work = IN_PLACE,
) -> TargetTrialsResult:
    """Try one cell for each seed.

    Raises
    ------
    InputError
        If the profile has no simulated cell of two arms, or a device that is not simulated.
    Cancelled
    """
    if profile.plant is None or len(profile.arms) != 2:
        raise InputError(f"profile {profile.name}: these trials need a section 'plant' and two arms")
    if not (profile.tracker.driver.needs_plant and all(arm.driver.needs_plant for arm in profile.arms.values())):
        raise InputError(f"profile {profile.name}: these trials need drivers of kind 'simulated' for all devices")
    plan = TargetsPlan(profile=profile, targets=targets, pairs=pairs)
    gathered = work.gather(CELLS, "targets", plan, [Seed(seed=seed) for seed in seeds])
    return TargetTrialsResult(profile=profile.name, trials=gathered.found, failed=gathered.failed)


def target_trial(task: TargetsPlan, drawn: Seed) -> TargetTrial:
    """Calibrate one cell with hidden effects, and measure new targets in it."""
    began, seed = time.perf_counter(), drawn.seed
    profile = with_hidden(task.profile, {}, seed)
    with TemporaryDirectory() as folder, new_planned_run(profile, Path(folder) / "run") as run:
        duration_s = planned_time(profile, read_planned_stops(run)).total_s
        hidden, laws = draw_hidden(task.profile, seed, duration_s)
        plant = build_plant(with_hidden(task.profile, hidden, seed))
        collect_run(run, opened=partial(open_cell, plant=plant))
        calibrate_run(run)
        found = discover_run(run)
        ranges = {name: ConditionRanges.of(run.readings(name)) for name in profile.arms}
        bench = _Bench(profile, plant, plant.clock_s, *_models(run), ranges, seed)
        pushing = time.perf_counter()
        states = {CALIBRATED: _state(bench, task)}
        push_seconds = time.perf_counter() - pushing
        location = _locate(run, bench)
        if location == "located":
            located = replace(bench, known_s=plant.clock_s, model=_models(run)[0], moved=True)
            states[RELOCATED] = _state(located, task)
    return TargetTrial(
        seed=seed,
        effects={name: _effects(tuple(hidden[name]), laws[name], found, name) for name in profile.arms},
        states=states,
        location=location,
        seconds=time.perf_counter() - began,
        push_seconds=push_seconds,
    )


CELLS = TaskKind("cellapp.commands.trials.target_trial:CELLS", TargetsPlan, Seed, TargetTrial, as_given, target_trial)


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Bench:
    """A calibrated cell: the run's profile, the cell itself, the model in force, and the paper's model.

    ``known_s`` is the time of the last reading or point that the model was fitted to [s]; ``moved`` whether the tracker
    has moved since. ``paper`` is the model of geometry and network in the base frame by the proposed method of Bai et
    al., from the same readings; its pair is identified from distances. ``ranges`` are those that the readings covered.
    """

    profile: Profile
    plant: Plant
    known_s: float
    model: CellModel
    paper: CellModel
    ranges: Mapping[str, ConditionRanges]
    seed: int
    moved: bool = False


def _models(run: RunFile) -> tuple[CellModel, CellModel]:
    """Return the model in force, and that of the calibration."""
    stages = read_stages(run)
    return model_of(run, stage_in_force(run, stages)), model_of(run, stages.current[CALIBRATE])


def _effects(hidden: tuple[str, ...], laws: str, found: DiscoverResult, name: str) -> HiddenEffects:
    arm = found.arms[name]
    return HiddenEffects(hidden=hidden, laws=laws, found=tuple(one.effect for one in arm.accepted), verdict=arm.verdict)


def _locate(run: RunFile, bench: _Bench) -> LocateVerdict:
    """Move the tracker and locate it again; the new station is known as well as one measured by pacing."""
    pose, rng = bench.profile.tracker.pose, np.random.default_rng([bench.seed, _STATION_SEED])
    assert pose is not None
    turned = transform(rotation_z(rng.choice([-1.0, 1.0]) * rng.uniform(*_TURNED)), np.zeros(3))
    T_C_M = turned @ pose_matrix(pose)
    bench.plant.move_tracker(T_C_M)
    paced = T_C_M[:3, 3] + _PACED_M * rng.standard_normal(3)
    yaw, pitch, roll = np.array(zyx_angles(T_C_M[:3, :3])) + _PACED_RAD * rng.standard_normal(3)
    rough = Pose(position=tuple(paced.tolist()), rpy=(roll, pitch, yaw))
    return locate_run(run, tracker_pose=rough, open_with=partial(open_cell, plant=bench.plant)).verdict


def _state(bench: _Bench, task: TargetsPlan) -> StateFigures:
    """Draw new targets, compensate them, and measure them."""
    seed = bench.seed + (_OTHER_TARGETS if bench.moved else 0)
    singles = draw_targets(bench.profile, bench.model, task.targets, seed)
    both = draw_pairs(bench.profile, bench.model, task.pairs, seed)
    result = _measured(bench, [*singles, *both])
    names = {target.name for target in singles}
    alone = [target for target in result.targets if target.name in names]
    return StateFigures(
        arms={
            name: _arm_figures(bench, name, [target for target in alone if target.arm == name])
            for name in bench.profile.arms
        },
        pair=_pair_figures(bench, result) if result.pairs else None,
    )


def _measured(bench: _Bench, targets: Sequence[Target]) -> VerifyResult:
    commands = compensate(bench.profile, bench.model, targets, ranges=bench.ranges)
    return push(bench.profile, bench.model, commands, verify=True, open_with=partial(open_cell, plant=bench.plant))


def _arm_figures(bench: _Bench, name: str, targets: Sequence[MeasuredTarget]) -> ArmFigures:
    done = [one for one in targets if None not in (one.nominal_mm, one.compensated_mm, one.q)]
    if not done:
        raise InputError(f"seed {bench.seed}, arm {name}: no target could be measured: {targets[0].note}")
    q, measured_M = _rows([one.q for one in done]), _rows([one.measured_M for one in done])
    predicted_M = _rows([one.predicted_M for one in done])
    model = bench.model.arms[name]
    approach = np.array([one.approach for one in done], dtype=np.float64)
    limit = _NORMAL_95 * _measured_sd(model, q, approach, bench.ranges[name])
    stated = [one for one in done if one.within_mm is not None]
    paper_M = None if bench.moved else bench.paper.arms[name].predict(q)
    return ArmFigures(
        targets=len(done),
        refused=len(targets) - len(done),
        nominal_mm=_mean([one.nominal_mm for one in done]),
        compensated_mm=_mean([one.compensated_mm for one in done]),
        floor_mm=1e3 * float(np.linalg.norm(_scatter(bench, {name: q})[name], axis=-1).mean()),
        changed_mm=1e3 * float(np.linalg.norm(_changed(bench, name, q), axis=1).mean()),
        paper_mm=None if paper_M is None else 1e3 * float(np.linalg.norm(measured_M - paper_M, axis=1).mean()),
        within_95=mean_of(float((one.compensated_mm or 0.0) <= (one.within_mm or 0.0)) for one in stated),
        coordinates_95=float(np.mean(np.abs(measured_M - predicted_M) <= limit)),
    )


def _pair_figures(bench: _Bench, result: VerifyResult) -> PairFigures:
    """Return the figures of the cooperative targets; each arm's part is a target of the same name."""
    done = [pair for pair in result.pairs if pair.nominal_mm is not None and pair.compensated_mm is not None]
    parts = {(target.name, target.arm): target for target in result.targets}
    names = done[0].arms
    q = {name: _rows([parts[pair.name, name].q for pair in done]) for name in names}
    measured = {name: _rows([parts[pair.name, name].measured_M for pair in done]) for name in names}
    apart = np.linalg.norm(measured[names[0]] - measured[names[1]], axis=1)
    noise = _scatter(bench, q)
    beam = (measured[names[0]] - measured[names[1]]) / apart[:, None]
    along = np.einsum("knc,nc->kn", noise[names[0]] - noise[names[1]], beam)
    return PairFigures(
        targets=len(done),
        refused=len(result.pairs) - len(done),
        nominal_mm=_mean([pair.nominal_mm for pair in done]),
        compensated_mm=_mean([pair.compensated_mm for pair in done]),
        floor_mm=1e3 * float(np.abs(along).mean()),
        paper_mm=_paper_pair_mm(bench, q, apart),
    )


def _paper_pair_mm(bench: _Bench, q: Mapping[str, Array], apart: Array) -> float | None:
    """Return the mean absolute error [mm] of SMR distances predicted by the paper's proposed method."""
    paper = bench.paper
    if paper.pair is None or paper.T_R_L is None:
        return None
    p_B = [paper.arms[name].in_base().predict(q[name]) for name in paper.pair]
    return 1e3 * float(np.abs(apart - distances(paper.T_R_L, p_B[0], p_B[1])).mean())


def _scatter(bench: _Bench, q: Mapping[str, Array]) -> dict[str, Array]:
    """Draw errors (k, n, 3) [m] of k repeated measurements at ``q``, arm -> (n, N) [rad]: noise and repeatability."""
    rng = np.random.default_rng([bench.seed, _FLOOR_SEED])
    plant, errors = bench.plant, {}
    for name, here in q.items():
        exact = plant.smr_positions(name, here)
        drawn = []
        for _ in range(_FLOOR_DRAWS):
            stopped = here + plant.config.repeatability * rng.standard_normal(here.shape)
            drawn.append(plant.measure_positions(plant.smr_positions(name, stopped), rng)[0] - exact)
        errors[name] = np.array(drawn)
    return errors


def _changed(bench: _Bench, name: str, q: Array) -> Array:
    """Compute the displacement (n, 3) [m] at ``q`` (n, N) [rad] by effects of time since the model was last fitted.

    No calibration can predict it, unless it follows a law that the run shows.
    """
    times = (np.array([time_s]) for time_s in (bench.known_s, bench.plant.clock_s))
    then, now = (bench.plant.smr_positions(name, q, time_s=time_s) for time_s in times)
    return now - then


def _measured_sd(model: ArmModel, q: Array, approach: Array, ranges: ConditionRanges) -> Array:
    """Return standard deviations (n, 3) [m] of measured coordinates about the prediction, as the product states."""
    conditions = MeasurementConditions(approach=approach)
    covariance = spread_of(model, q, conditions, ranges).of_model
    if model.posterior is not None and ranges.noise is not None:
        covariance = covariance + ranges.noise.covariance(model.predict(q, approach), model.posterior.noise_m)
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def _rows(vectors: Sequence[tuple[float, ...] | None]) -> Array:
    """Stack vectors (n, N) of measured targets, which all have them."""
    return np.array(vectors, dtype=np.float64)


def _mean(values: Sequence[float | None]) -> float:
    return float(np.mean(np.array(values, dtype=np.float64)))
