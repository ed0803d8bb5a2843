"""The verb: from the readings of a run to a calibrated cell and the numbers that say how good it is."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

import cellapp
from cellapp.calibration.cooperative import PairCalibration, calibrate_pair
from cellapp.calibration.evaluation import evaluate, repeatability
from cellapp.calibration.identification import (
    Identification,
    TooFewReadings,
    identify_with_excess,
    start_from_nominal,
)
from cellapp.calibration.residual import SHAPES, Shape, Training, train_network
from cellapp.calibration.splits import draw_splits
from cellapp.calibration.station import station_change
from cellapp.errors import InputError
from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel, ResidualNetwork
from cellapp.model.nominal import (
    bodies_of,
    nominal_arm,
    prior_sigmas,
    up_in_tracker,
)
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings, RunFile, stated_uncertainty

CALIBRATION_FILE = "calibration.json"
RESULT = "calibrate"


@dataclass(frozen=True)
class ArmCalibration:
    """One arm's calibration: the model, how it was identified, and its errors on held-out stops by stage.

    ``excess_m`` is the standard deviation of a coordinate [m] beyond what the readings state of themselves;
    ``training`` tells how the residual network came about, ``tracker_trained`` is the paper's counter-example: the same
    network trained in the tracker frame.
    """

    model: ArmModel
    identification: Identification
    excess_m: float
    validate: Mapping[str, Mapping[str, Any]]
    counts: Mapping[str, int]
    repeatability: Mapping[str, float | int] | None
    tracker_mm: float | None
    training: Training | None = None
    tracker_trained: ResidualNetwork | None = None


@dataclass(frozen=True)
class Calibration:
    """The calibrated cell with everything that is reported of it."""

    model: CellModel
    arms: Mapping[str, ArmCalibration]
    pair: PairCalibration | None
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The object that ``--json`` writes."""
        return {
            "schema": "cellapp-calibrate",
            "version": 1,
            "arms": {name: _arm_dict(arm) for name, arm in self.arms.items()},
            "pair": {} if self.pair is None else self.pair.as_dict(),
            "notes": list(self.notes),
            "provenance": dict(self.model.provenance),
        }


def calibrate_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> Calibration:
    """Calibrate a run: draw missing splits, identify, evaluate, and write ``calibration.json`` and the result.

    Raises
    ------
    InputError
        If an arm has no readings or too few of them.
    Cancelled
        If the token says so; nothing is written then.
    """
    cancel = cancel or CancelToken()
    profile = run.profile
    notes = list(ensure_splits(run))
    readings = {name: run.readings(name) for name in profile.arms}
    calibration = calibrate_readings(profile, readings, listener, cancel)
    calibration = replace(calibration, notes=(*notes, *calibration.notes))
    store(run, calibration)
    return calibration


def calibrate_readings(
    profile: Profile,
    readings: Mapping[str, Readings],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> Calibration:
    """Calibrate from readings whose splits are drawn: geometry, networks, pair. Raises as ``calibrate_run``."""
    cancel = cancel or CancelToken()
    notes: list[str] = []
    total = 2 * len(readings) + 1
    arms: dict[str, ArmCalibration] = {}
    for name, arm_readings in readings.items():
        listener(Progress("calibrate", len(arms), total, f"arm {name}: geometry"))
        cancel.check()
        arms[name], arm_notes = calibrate_arm(profile, name, arm_readings)
        notes += arm_notes
    if profile.network.kind == "mlp":
        listener(Progress("calibrate", len(arms), total, "residual networks"))
        with ThreadPoolExecutor(max_workers=2) as pool:  # torch works outside the interpreter lock
            tasks = {name: pool.submit(train_arm, profile, arm, readings[name], cancel) for name, arm in arms.items()}
            for name, task in tasks.items():
                arms[name] = task.result()
                listener(Progress("calibrate", len(arms) + 1, total, f"arm {name}: network"))
    listener(Progress("calibrate", total - 1, total, "pair"))
    cancel.check()
    pair, pair_notes = calibrate_pair(profile, readings, arms)
    notes += pair_notes
    names = tuple(profile.arms)
    model = CellModel(
        arms={name: arm.model for name, arm in arms.items()},
        T_R_L=None if pair is None else pair.T_R_L,
        pair=None if pair is None else (names[0], names[1]),
        provenance={
            "profile": profile.name,
            "seed": profile.seed,
            "program": f"cellapp {cellapp.__version__}",
            "python": platform.python_version(),
            "numpy": np.__version__,
            "torch": version("torch"),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )
    listener(Progress("calibrate", total, total, "done"))
    return Calibration(model, arms, pair, tuple(notes))


def store(run: RunFile, calibration: Calibration) -> None:
    """Write the model beside the run file and the numbers into it."""
    calibration.model.save(run.folder / CALIBRATION_FILE)
    run.write_result(RESULT, json.dumps(calibration.as_dict()))


def ensure_splits(run: RunFile) -> tuple[str, ...]:
    """Draw the splits of stops that have none, the same for both arms, and store them. Returns notes."""
    profile = run.profile
    readings = {name: run.readings(name) for name in profile.arms}
    for name, arm in readings.items():
        if len(arm) == 0:
            raise InputError(
                f"{run.path}: arm '{name}' has no readings; collect or import them, or take the arm out of the profile"
            )
    known: dict[int, str | None] = {}
    for arm in readings.values():
        for number, word in zip(arm.configuration.tolist(), arm.split or [None] * len(arm), strict=True):
            if word is not None:
                known[number] = word
    if known:
        return ()
    drawn, notes = profile_splits(profile, readings)
    for name, words in drawn.items():
        run.assign_splits(name, words)
    return notes


def profile_splits(
    profile: Profile, readings: Mapping[str, Readings]
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """A split for each reading of each arm as the profile asks for and its seed draws it, and notes."""
    splits = profile.splits
    numbers = np.concatenate([arm.configuration for arm in readings.values()])
    validate = None if splits.validate_ == "rest" else splits.validate_
    drawn, notes = draw_splits(numbers, splits.identify, splits.train, validate, profile.seed)
    words = {name: tuple(drawn[number] for number in arm.configuration.tolist()) for name, arm in readings.items()}
    return words, notes


def calibrate_arm(profile: Profile, name: str, readings: Readings) -> tuple[ArmCalibration, list[str]]:
    """Identify one arm on its identify split and evaluate it on its validate split. Returns notes beside it."""
    arm = profile.arms[name]
    identify_rows, validate_rows = readings.in_split("identify"), readings.in_split("validate")
    if len(identify_rows) < 4 or len(validate_rows) < 1:
        raise InputError(
            f"arm '{name}': {len(readings)} readings leave {len(identify_rows)} to identify and {len(validate_rows)} to"
            f" validate; at least 4 and 1 are needed to begin with: measure more configurations"
        )
    here, held_out = readings.take(identify_rows), readings.take(validate_rows)
    nominal = start_from_nominal(nominal_arm(arm), here.q, here.p_M, tool_unknown=arm.smr.offset == "unknown")
    settings = profile.calibration
    priors = prior_sigmas(nominal, settings.priors)
    try:
        identification, excess = identify_with_excess(
            nominal,
            here.q,
            here.p_M,
            sigma=stated_uncertainty(here),
            parameter_set=settings.parameter_set,
            prior_sigma=priors,
            robust=settings.robust,
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )
    except TooFewReadings as error:
        raise InputError(f"arm '{name}': {error}") from None
    except ValueError as error:
        raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None
    model = ArmModel(
        geometry=identification.geometry,
        nominal=nominal,
        bodies=bodies_of(arm),
        up_M=up_in_tracker(profile),
        smr_normal=np.array(arm.smr.normal, dtype=np.float64),
        identified=identification.names,
        covariance=identification.covariance,
    )
    stages = {
        "nominal": evaluate(held_out.p_M, smr_positions(nominal, held_out.q)),
        "geometry": evaluate(held_out.p_M, smr_positions(identification.geometry, held_out.q)),
    }
    counts = {word: len(readings.in_split(word)) for word in ("identify", "train", "validate")}
    notes = [] if identification.converged else [f"arm '{name}': {identification.message}; do not use this calibration"]
    moved = station_change(smr_positions(nominal.with_T_M_B(np.eye(4)), readings.q), readings.p_M)
    if moved is not None:
        notes.append(
            f"arm '{name}': the tracker or the base seems to have been moved before configuration"
            f" {readings.configuration[moved]}; import the two parts as runs of their own"
        )
    stated = stated_uncertainty(held_out)
    calibration = ArmCalibration(
        model=model,
        identification=identification,
        excess_m=excess,
        validate=stages,
        counts=counts,
        repeatability=repeatability(readings.q, readings.p_M),
        tracker_mm=None if stated is None else rms_length_mm(stated),
    )
    return calibration, notes


def train_arm(
    profile: Profile, arm: ArmCalibration, readings: Readings, cancel: CancelToken | None = None
) -> ArmCalibration:
    """Train the residual network of an arm in its base frame, and the same in the tracker frame for comparison.

    It learns from the train split, or from the identify split where there is no train split.
    """
    rows = readings.in_split("train")
    learn = readings.take(rows if len(rows) else readings.in_split("identify"))
    held_out = readings.take(readings.in_split("validate"))
    if len(learn) < 2 * profile.network.folds:
        return arm
    rotation = arm.model.geometry.T_M_B()[:3, :3]
    left_M = learn.p_M - arm.model.predict(learn.q, learn.approach, learn.payload_kg)

    def train(residual: Array, shapes: Sequence[Shape]) -> Training:
        return train_network(
            learn.q,
            residual,
            seed=profile.seed,
            folds=profile.network.folds,
            iterations=profile.network.iterations,
            shapes=shapes,
            cancel=cancel,
        )

    training = train(left_M @ rotation, SHAPES)
    if training.network is None:
        return replace(arm, training=training)
    # the same layers; nothing there turns with joint 1, as the tracker knows nothing of that axis
    in_tracker = train(left_M, (replace(training.shape, turning=False),)).network
    model = replace(arm.model, network=training.network)
    computed = model.predict(held_out.q, held_out.approach, held_out.payload_kg)
    stages = {**arm.validate, "network": evaluate(held_out.p_M, computed)}
    return replace(arm, model=model, validate=stages, training=training, tracker_trained=in_tracker)


def rms_length_mm(sigma: Array) -> float:
    """Root mean square length of the stated noise, from sigmas (n,) [m] or covariances (n, 3, 3) [m^2]."""
    squares = 3.0 * sigma**2 if sigma.ndim == 1 else np.trace(sigma, axis1=1, axis2=2)
    return float(np.sqrt(squares.mean())) * 1e3


def _arm_dict(arm: ArmCalibration) -> dict[str, Any]:
    result = arm.identification
    return {
        "identified": {
            name: {"value": value, "standard_error": error, "unit": unit}
            for name, value, error, unit in zip(
                result.names, result.values.tolist(), result.standard_errors.tolist(), result.units, strict=True
            )
        },
        "rank": len(result.parameter_set.columns),
        "parameter_set": result.parameter_set.name,
        "merged": result.parameter_set.merged,
        "iterations": result.iterations,
        "converged": result.converged,
        "message": result.message,
        "condition": result.condition if np.isfinite(result.condition) else None,
        "observability": result.observability,
        "scatter": {
            "value": result.scale,
            "meaning": "root of chi-square per degree of freedom against the stated uncertainty, or metres without one",
        },
        "excess_mm": arm.excess_m * 1e3,
        "degrees_of_freedom": result.degrees_of_freedom,
        "splits": dict(arm.counts),
        "tracker_mm": arm.tracker_mm,
        "repeatability_mm": None if arm.repeatability is None else dict(arm.repeatability),
        "network": None if arm.training is None else _training_dict(arm.training),
        "validate": {stage: dict(errors) for stage, errors in arm.validate.items()},
    }


def _training_dict(training: Training) -> dict[str, Any]:
    return {
        "used": training.network is not None,
        "inputs": training.shape.inputs,
        "hidden": list(training.shape.hidden),
        "turning": training.shape.turning,
        "left_out_rms_mm": training.left_out_rms * 1e3,
        "without_rms_mm": training.without_rms * 1e3,
        "tried": [
            {
                "inputs": shape.inputs,
                "hidden": list(shape.hidden),
                "turning": shape.turning,
                "left_out_rms_mm": error * 1e3,
            }
            for shape, error in training.tried
        ],
    }
