"""Whole simulated cells, each with the twin's hidden effects and one more in each arm, half of them with laws of
another shape, from the plan to new targets that are compensated, driven to and measured. Then the tracker moves 8 to 25
degrees around the cell, is located again from four points, and other targets are measured. *Floor*: the mean error of
measuring the same point again."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant, open_cell
from cellapp.cell.driving.target_visit import push
from cellapp.cell.planning.planned_stops import planned_time, read_planned_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.prediction import spread_of
from cellapp.cell.targets.ranges import ConditionRanges, unknown_conditions
from cellapp.cell.targets.records import MeasuredTarget, VerifyResult
from cellapp.cell.targets.targets import Target
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.commands.trials.blind import with_hidden
from cellapp.estimation.calibration.least_squares import NORMAL_95
from cellapp.estimation.calibration.pair_calibration import distances
from cellapp.estimation.monitoring.records import LocateVerdict
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.results import CALIBRATE
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, apply, invert, rotation_z, transform, zyx_angles
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import pose_matrix
from drivers.plant import Plant
from tests.evidence.shared.cells import TWIN
from tests.evidence.shared.target_samples import sample_hidden, sample_pairs, sample_targets
from tests.evidence.skeleton import Evidence, Limit, Table
from tests.sure import sure
from tests.verbs import Opened, collect_by, locate_run, opened_by

_FLOOR_SEED = 0xF100
"""Mixed with the trial's seed."""
_STATION_SEED = 0x57A7
"""Mixed with the trial's seed."""
_OTHER_TARGETS = 1000
"""Added to the trial's seed for the targets after the tracker has moved."""
_ROTATION = (math.radians(8.0), math.radians(25.0))
"""Range of the angle about the cell's z axis from the old station to the new one: some steps to one side."""
_PACED_M, _PACED_RAD = 0.02, math.radians(0.4)
"""Standard deviation of each coordinate and angle of a station measured by pacing."""
_FLOOR_SAMPLES = 5
"""Repeated measurements of each target: with 200 targets the mean is known to 1.5 %."""


TITLE = "Targets"
LEAST_RATIO, MOST_OF_FLOOR, LEAST_GAIN, WITHIN_95 = 15.0, 1.5, 0.4, (0.93, 0.97)
"""Limits on the means: nominal over compensated error; compensated error over the floor; share of the paper's
cooperative error that is removed; share of measurements within the stated 95 % limits."""
CALIBRATED, RELOCATED = "calibrated", "tracker moved"
OPTIONS = {"seeds": 10, "first": 0, "targets": 200}
"""``targets``: new targets of each arm, and cooperative ones."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    seeds = range(asked.first, asked.first + asked.seeds)
    return {f"seed {seed}": {"seed": seed, "targets": asked.targets} for seed in seeds}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Calibrate one cell with hidden effects, and measure new targets in it."""
    twin, seed = load_profile(TWIN), case["seed"]
    profile = with_hidden(twin, {}, seed)
    with TemporaryDirectory() as folder, new_planned_run(profile, Path(folder) / "run") as run:
        duration_s = planned_time(profile, read_planned_stops(run)).total_s
        hidden = sample_hidden(twin, seed, duration_s)
        plant = build_plant(with_hidden(twin, hidden, seed))
        collect_by(_kept(plant), run)
        calibrate_run(run)
        discover_run(run)
        ranges = {name: ConditionRanges.of(run.readings(name)) for name in profile.arms}
        bench = _Bench(profile, plant, *_models(run), ranges, seed)
        states = {CALIBRATED: _state(bench, case["targets"])}
        location = _locate(run, bench)
        if location == "located":
            located = replace(bench, model=_models(run)[0], moved=True)
            states[RELOCATED] = _state(located, case["targets"])
    return {"seed": seed, "states": states}


@dataclass(frozen=True, eq=False)
class _Bench:
    """A calibrated cell: the run's profile, the cell itself, the model in force, and the paper's model.

    ``moved`` is whether the tracker has moved since. ``paper`` is the model of geometry and network in the base frame
    by the proposed method of Bai et al., from the same readings; its pair is identified from distances. ``ranges`` are
    those that the readings covered.
    """

    profile: Profile
    plant: Plant
    model: CellModel
    paper: CellModel
    ranges: Mapping[str, ConditionRanges]
    seed: int
    moved: bool = False


def _models(run: RunFile) -> tuple[CellModel, CellModel]:
    """Return the model in force, and that of the calibration."""
    stages = read_stages(run)
    return model_of(run, stage_in_force(run, stages)), model_of(run, stages.current[CALIBRATE])


def _kept(plant: Plant) -> Opened:
    """Open the cell as the last job left it."""
    return lambda profile, **options: open_cell(profile, **{**options, "plant": plant})


def _locate(run: RunFile, bench: _Bench) -> LocateVerdict:
    """Move the tracker and locate it again; the new station is known as well as one measured by pacing."""
    pose, rng = bench.profile.tracker.pose, np.random.default_rng([bench.seed, _STATION_SEED])
    rotated = transform(rotation_z(rng.choice([-1.0, 1.0]) * rng.uniform(*_ROTATION)), np.zeros(3))
    T_C_M = rotated @ pose_matrix(sure(pose))
    bench.plant.move_tracker(T_C_M)
    paced = T_C_M[:3, 3] + _PACED_M * rng.standard_normal(3)
    yaw, pitch, roll = np.array(zyx_angles(T_C_M[:3, :3])) + _PACED_RAD * rng.standard_normal(3)
    rough = Pose(position=tuple(paced.tolist()), rpy=(roll, pitch, yaw))
    with opened_by(_kept(bench.plant)):
        return locate_run(run, tracker_pose=rough).verdict


def _state(bench: _Bench, count: int) -> dict[str, dict[str, float | None]]:
    """Draw new targets, compensate them, and measure them."""
    seed = bench.seed + (_OTHER_TARGETS if bench.moved else 0)
    singles = sample_targets(bench.profile, bench.model, count, seed)
    both = sample_pairs(bench.profile, bench.model, count, seed)
    result = _measured(bench, [*singles, *both])
    names = {target.name for target in singles}
    alone = [target for target in result.targets if target.name in names]
    arms = {
        name: _arm_figures(bench, name, [target for target in alone if target.arm == name])
        for name in bench.profile.arms
    }
    return {**arms, "both arms": _pair_figures(bench, result)}


def _measured(bench: _Bench, targets: Sequence[Target]) -> VerifyResult:
    commands = compensate(bench.profile, bench.model, targets, ranges=bench.ranges)
    with opened_by(_kept(bench.plant)):
        return push(bench.profile, bench.model, commands, verify=True)


def _arm_figures(bench: _Bench, name: str, targets: Sequence[MeasuredTarget]) -> dict[str, float | None]:
    done = [one for one in targets if None not in (one.nominal_mm, one.compensated_mm, one.q)]
    if not done:
        raise InputError(f"seed {bench.seed}, arm {name}: no target could be measured: {targets[0].note}")
    q, measured_M = _rows([one.q for one in done]), _rows([one.measured_M for one in done])
    predicted_M = _rows([one.predicted_M for one in done])
    model = bench.model.arms[name]
    approach = np.array([one.approach for one in done], dtype=np.float64)
    limit = NORMAL_95 * _measured_sd(model, q, approach, bench.ranges[name])
    stated = [one for one in done if one.within_mm is not None]
    paper_M = None if bench.moved else bench.paper.arms[name].predict(q)
    return dict[str, float | None](
        targets=len(done),
        refused=len(targets) - len(done),
        nominal_mm=_mean([one.nominal_mm for one in done]),
        compensated_mm=_mean([one.compensated_mm for one in done]),
        floor_mm=1e3 * float(np.linalg.norm(_scatter(bench, {name: q})[name], axis=-1).mean()),
        paper_mm=None if paper_M is None else 1e3 * float(np.linalg.norm(measured_M - paper_M, axis=1).mean()),
        within_95=mean_of(float((one.compensated_mm or 0.0) <= (one.within_mm or 0.0)) for one in stated),
        coordinates_95=float(np.mean(np.abs(measured_M - predicted_M) <= limit)),
    )


def _pair_figures(bench: _Bench, result: VerifyResult) -> dict[str, float | None]:
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
    return dict[str, float | None](
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
    arms = [(paper.arms[name], q[name]) for name in paper.pair]
    p_B = [apply(invert(arm.geometry.T_M_B()), arm.predict(here)) for arm, here in arms]
    return 1e3 * float(np.abs(apart - distances(paper.T_R_L, p_B[0], p_B[1])).mean())


def _scatter(bench: _Bench, q: Mapping[str, Array]) -> dict[str, Array]:
    """Draw errors (k, n, 3) [m] of k repeated measurements at ``q``, arm -> (n, N) [rad]: noise and repeatability."""
    rng = np.random.default_rng([bench.seed, _FLOOR_SEED])
    plant, errors = bench.plant, {}
    for name, here in q.items():
        exact = plant.smr_positions(name, here)
        drawn = []
        for _ in range(_FLOOR_SAMPLES):
            stopped = here + plant.config.repeatability * rng.standard_normal(here.shape)
            drawn.append(plant.measure_positions(plant.smr_positions(name, stopped), rng)[0] - exact)
        errors[name] = np.array(drawn)
    return errors


def _measured_sd(model: ArmModel, q: Array, approach: Array, ranges: ConditionRanges) -> Array:
    """Return standard deviations (n, 3) [m] of measured coordinates about the prediction, as the product states.

    Targets state the side of approach alone: the time, for example, is unknown, and they are measured after the run.
    """
    conditions = MeasurementConditions(approach=approach)
    unknown = unknown_conditions(model, q, conditions, ranges)
    covariance = spread_of(model, q, conditions, ranges).of_model + sum(one.covariance for one in unknown)
    if model.posterior is not None and ranges.noise is not None:
        covariance = covariance + ranges.noise.covariance(model.predict(q, conditions), model.noise(q))
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def _rows(vectors: Sequence[tuple[float, ...] | None]) -> Array:
    """Stack vectors (n, N) of measured targets, which all have them."""
    return np.array(vectors, dtype=np.float64)


def _mean(values: Sequence[float | None]) -> float:
    return float(np.mean(np.array(values, dtype=np.float64)))


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    figures, limits, errors = dict[str, str](), list[Limit](), list[list[str]]()
    for state in (CALIBRATED, RELOCATED):
        cells = [its["states"][state] for its in results if state in its["states"]]
        for who in cells[0] if cells else ():
            own = [cell[who] for cell in cells]
            mean = {key: mean_of(one.get(key) for one in own) for one in own for key in one}
            ratio, of_floor = mean["nominal_mm"] / mean["compensated_mm"], mean["compensated_mm"] / mean["floor_mm"]
            worst = max(one["compensated_mm"] / one["floor_mm"] for one in own)
            refused = f"{sum(one['refused'] for one in own)} of {sum(one['refused'] + one['targets'] for one in own)}"
            paper = "" if mean["paper_mm"] is None else f"{mean['paper_mm']:.3f} mm"
            errors.append(
                [
                    *(state, who, str(len(own)), f"{mean['nominal_mm']:.3f} mm"),
                    *(f"**{mean['compensated_mm']:.4f} mm** ({ratio:.0f} times less)", f"{mean['floor_mm']:.4f} mm"),
                    *(f"{of_floor:.2f}, {worst:.2f}", paper, refused),
                ]
            )
            if state == CALIBRATED:
                figures[f"{who}_ratio"] = f"{ratio:.0f}"
            if who == "both arms":
                if mean["paper_mm"] is not None:
                    gain = 1.0 - mean["compensated_mm"] / mean["paper_mm"]
                    limits.append(Limit(f"{state}, below the paper's method", gain, least=LEAST_GAIN))
                continue
            limits.append(Limit(f"{state}, {who}, nominal over compensated", ratio, least=LEAST_RATIO))
            limits.append(Limit(f"{state}, {who}, over the floor", of_floor, MOST_OF_FLOOR))
            for what in ("within_95", "coordinates_95"):
                limits.append(Limit(f"{state}, {who}, {what}", mean[what], WITHIN_95[1], WITHIN_95[0]))
    columns = ["state", "of", "cells", "uncompensated", "compensated", "floor", "over the floor: mean, worst cell"]
    return Evidence(figures, [Table("Mean errors", [*columns, "paper's method", "refused"], errors)], limits)


def mean_of(values: Iterable[float | None]) -> Any:
    """Return the mean of the values that are not None; None if there are none."""
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there else None
