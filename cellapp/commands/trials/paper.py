"""The comparison of three methods of Bai et al., ROBOT 45(3), 2023, over many simulated cells.

Every seed is another cell: other true arms, bases, plan, noise and splits; the hidden physics is the profile's. Each
seed also moves the tracker to another station, laid on its side so that its frame differs in every axis, and evaluates
two networks there: the one trained in the base frame must still help, the one trained in the tracker frame must not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import itemgetter

import numpy as np

from cellapp.cell.planning.plan import plan_stops
from cellapp.commands.trials.drawn_cell import drawn_cell
from cellapp.commands.trials.measured import measured_plan
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.view.table import Number, Table, table_of
from cellapp.commands.view.words import METHOD_WORDS
from cellapp.estimation.calibration.calibrate import ArmCalibration, calibrate_readings
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Pose, Profile
from cellapp.ground.results import Method, Record, Result
from cellapp.ground.scale.task import Seed, SimulatedCell, TaskKind, profile_of
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, register

PAPER_COOPERATIVE_MM = {"method_1": 0.2319, "method_2": 0.4669, "proposed": 0.1676}
"""Mean cooperative errors of Bai et al., ROBOT 45(3), 2023."""
PAPER_GAIN = 0.277
"""Share of method 1's error that the paper's proposed method removes."""
_METHODS: tuple[Method, ...] = ("nominal", "method_1", "method_2", "proposed")
_STATIONS = (math.radians(70.0), math.radians(-70.0))
"""Angles about the cell's z axis to the moved tracker stations: far to either side."""


class PaperTrial(Record):
    """One seed.

    Attributes
    ----------
    gain : float
        Share of method 1's cooperative error that the proposed method removes.
    cooperative_mm : mapping
        Method -> mean cooperative error [mm].
    position_mm : mapping
        Arm -> model stage -> mean position error [mm].
    moved_mm : mapping
        Arm -> geometry, base_frame or tracker_frame -> mean position error [mm] at the moved tracker station.
    """

    seed: int
    gain: float
    cooperative_mm: Mapping[str, float]
    position_mm: Mapping[str, Mapping[str, float]]
    moved_mm: Mapping[str, Mapping[str, float]]


class BesidePaper(Record):
    """Median and worst over the seeds, and the paper's figure where it has one."""

    median: float
    worst: float
    paper: float | None


class PaperResult(Result, schema="cellapp-trials-paper"):
    """``trials paper``: cooperative errors by method, the gain of the proposed method, every seed, and what failed."""

    cooperative_mm: Mapping[str, BesidePaper]
    gain: BesidePaper
    trials: tuple[PaperTrial, ...]
    failed: tuple[str, ...] = ()


def paper_trials(
    profile: Profile,
    seeds: Sequence[int],
    work: Work = IN_PLACE,
) -> PaperResult:
    """Run the comparison for every seed. Raises as ``gather`` does, and ``InputError`` as ``paper_trial`` does."""
    drawn = [Seed(seed=seed) for seed in seeds]
    gathered = work.gather(CELLS, "paper", SimulatedCell(profile=profile), drawn)
    return paper_result(gathered.found, gathered.failed)


def paper_trial(profile: Profile, seed: int) -> PaperTrial:
    """Run the comparison for one seed. Raises ``InputError`` if the profile is not suitable."""
    if profile.plant is None or len(profile.arms) != 2:
        raise InputError(f"profile {profile.name}: the comparison needs a section 'plant' and two arms")
    profile = drawn_cell(profile, seed)
    plan = plan_stops(profile)
    readings = measured_plan(profile, plan, seed)
    calibration = calibrate_readings(profile, readings)
    if calibration.pair is None:
        raise InputError(f"profile {profile.name}: {'; '.join(calibration.notes)}")
    methods = calibration.pair.methods
    first = methods["method_1"].by_distances.mean
    cooperative: dict[str, float] = {
        name: methods[name].by_distances.mean if name in methods else first for name in _METHODS
    }
    elsewhere = _moved(profile, seed)
    seen_elsewhere = measured_plan(elsewhere, plan, seed + 1)
    return PaperTrial(
        seed=seed,
        gain=1.0 - cooperative["proposed"] / cooperative["method_1"],
        cooperative_mm=cooperative,
        position_mm={
            name: {stage: errors.position_mm.mean for stage, errors in arm.validate.items()}
            for name, arm in calibration.arms.items()
        },
        moved_mm={name: _at_other_station(arm, seen_elsewhere[name]) for name, arm in calibration.arms.items()},
    )


def _moved(profile: Profile, seed: int) -> Profile:
    """Return the same cell with the tracker moved to one side and laid on its side."""
    pose = profile.tracker.pose
    if pose is None:
        raise InputError(f"profile {profile.name}: tracker.pose is missing; it says where the tracker stands")
    turn = _STATIONS[seed % 2]
    x, y, z = pose.position
    c, s = math.cos(turn), math.sin(turn)
    _, pitch, yaw = pose.rpy
    on_its_side = math.copysign(math.pi / 2.0, turn)
    moved = Pose(position=(c * x - s * y, s * x + c * y, z), rpy=(on_its_side, pitch, yaw + turn))
    return profile.model_copy(update={"tracker": profile.tracker.model_copy(update={"pose": moved})})


def _at_other_station(arm: ArmCalibration, readings: Readings) -> dict[str, float]:
    """Return mean errors [mm] on held-out stops from another station; the base is registered there by geometry only."""
    learn, held_out = readings.in_split("identify"), readings.in_split("validate")
    p_B = smr_positions(arm.model.geometry.with_T_M_B(np.eye(4)), readings.q)
    T_M_B = register(readings.p_M[learn], p_B[learn])
    p_B, q, measured = p_B[held_out], readings.q[held_out], readings.p_M[held_out]

    def mean_mm(computed: Array) -> float:
        return float(np.linalg.norm(measured - computed, axis=1).mean()) * 1e3

    errors = {"geometry": mean_mm(apply(T_M_B, p_B))}
    if arm.model.network is not None:
        errors["base_frame"] = mean_mm(apply(T_M_B, p_B + arm.model.network.correct(q)))
    if arm.tracker_frame_network is not None:
        errors["tracker_frame"] = mean_mm(apply(T_M_B, p_B) + arm.tracker_frame_network.correct(q))
    return errors


def paper_result(trials: Sequence[PaperTrial], failed: tuple[str, ...] = ()) -> PaperResult:
    """Return median and worst values over the seeds beside the paper's figures."""
    gains = [trial.gain for trial in trials]
    errors = {method: [trial.cooperative_mm[method] for trial in trials] for method in _METHODS}
    return PaperResult(
        cooperative_mm={
            method: BesidePaper(
                median=float(np.median(values)), worst=max(values), paper=PAPER_COOPERATIVE_MM.get(method)
            )
            for method, values in errors.items()
        },
        gain=BesidePaper(median=float(np.median(gains)), worst=min(gains), paper=PAPER_GAIN),
        trials=tuple(trials),
        failed=failed,
    )


def paper_tables(result: PaperResult) -> list[Table]:
    """Show the methods over the seeds beside the paper, and position errors at both tracker stations."""
    gain = (result.gain.median, result.gain.worst, result.gain.paper)
    rows = [
        *(
            (METHOD_WORDS[method], entry.median, entry.worst, entry.paper)
            for method in _METHODS
            if (entry := result.cooperative_mm.get(method)) is not None
        ),
        (
            f"{METHOD_WORDS['proposed']}, below {METHOD_WORDS['method_1']}",
            *(None if share is None else Number(100 * share, 1, "%") for share in gain),
        ),
    ]
    fields = [(title, itemgetter(place), ".4f") for place, title in enumerate(("median", "worst", "paper"), start=1)]
    title = f"Mean cooperative error [mm], {len(result.trials)} simulated cells"
    tables = [table_of(title, rows, ("method", itemgetter(0)), *fields)]
    headings = {"position_mm": "Mean position error [mm]", "moved_mm": "At another tracker station [mm]"}
    for where, heading in headings.items():
        trials = [getattr(trial, where) for trial in result.trials]
        stages = [(name, stage) for name, its in trials[0].items() for stage in its]
        shown = {
            f"{name}, {stage}": sorted(arms[name][stage] for arms in trials if stage in arms[name])
            for name, stage in stages
        }
        tables.append(
            table_of(
                heading,
                shown.items(),
                ("arm, model", itemgetter(0)),
                ("median", lambda one: one[1][len(one[1]) // 2], ".4f"),
                ("worst", lambda one: one[1][-1], ".4f"),
            )
        )
    return tables


def _trial(profile: Profile, drawn: Seed) -> PaperTrial:
    return paper_trial(profile, drawn.seed)


CELLS = TaskKind("cellapp.commands.trials.paper:CELLS", SimulatedCell, Seed, PaperTrial, profile_of, _trial)
