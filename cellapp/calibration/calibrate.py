"""Calibration: identified arms, residual networks and inter-base transform from readings, with held-out errors."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from cellapp.calibration.arm_identification import identify_with_excess
from cellapp.calibration.evaluation import evaluate, repeatability
from cellapp.calibration.identification import Identification, TooFewReadings, start_from_nominal
from cellapp.calibration.network_training import Shape, Training, train_network, training_steps
from cellapp.calibration.pair_calibration import PairCalibration, calibrate_pair
from cellapp.calibration.splits import draw_splits
from cellapp.calibration.station_change import station_change
from cellapp.errors import InputError
from cellapp.kinematics.chain import Geometry, smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel, ResidualNetwork
from cellapp.model.nominal import (
    bodies_of,
    nominal_arm,
    prior_sigmas,
    up_in_tracker,
)
from cellapp.plugins import program_of
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, Report, SharedProgress, ignore, ignore_report
from cellapp.results import ArmPriorResult, Provenance, Repeatability, Stage, StageErrors
from cellapp.run import SPLITS, Readings, stated_uncertainty

_BASE_STEPS = training_steps()
_TRAINING_STEPS = _BASE_STEPS + training_steps(1)
"""Steps of an arm's training: in the base frame, and of the best shape in the tracker frame."""


@dataclass(frozen=True)
class ArmCalibration:
    """One calibrated arm.

    Attributes
    ----------
    model : ArmModel
    identification : Identification
    excess_m : float
        Standard deviation of a coordinate beyond the stated uncertainty [m].
    validate : mapping
        Held-out errors by model stage.
    counts : mapping
        Number of readings in each split.
    repeatability : Repeatability or None
    tracker_mm : float or None
        Rms length of the stated noise [mm].
    training : Training or None
        How the residual network was trained.
    tracker_frame_network : ResidualNetwork or None
        The same network trained in the tracker frame, the counter-example of Bai et al. (2023).
    prior : ArmPriorResult or None
        The earlier calibration that was taken as prior; identification and model are then with it, without a network.
    """

    model: ArmModel
    identification: Identification
    excess_m: float
    validate: Mapping[Stage, StageErrors]
    counts: Mapping[str, int]
    repeatability: Repeatability | None
    tracker_mm: float | None
    training: Training | None = None
    tracker_frame_network: ResidualNetwork | None = None
    prior: ArmPriorResult | None = None


@dataclass(frozen=True)
class Calibration:
    """The calibrated cell: its model, every arm, the pair, and notes for the operator."""

    model: CellModel
    arms: Mapping[str, ArmCalibration]
    pair: PairCalibration | None
    notes: tuple[str, ...]
    provenance: Provenance


def calibrate_readings(
    profile: Profile,
    readings: Mapping[str, Readings],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> Calibration:
    """Calibrate from readings whose splits are drawn: geometry, networks, pair.

    Raises
    ------
    InputError
        If an arm has too few readings.
    Cancelled
        If the token says so.
    """
    cancel = cancel or CancelToken()
    notes: list[str] = []
    training = _TRAINING_STEPS if profile.network.kind == "mlp" else 0
    total = (1 + training) * len(readings) + 1
    arms: dict[str, ArmCalibration] = {}
    for name, arm_readings in readings.items():
        listener(Progress("calibrate", len(arms), total, f"arm {name}: geometry"))
        cancel.check()
        arms[name], arm_notes = calibrate_arm(profile, name, arm_readings)
        notes += arm_notes
    if profile.network.kind == "mlp":
        listener(Progress("calibrate", len(arms), total, "residual networks"))
        with ThreadPoolExecutor(max_workers=2) as pool:  # the matrix products work outside the interpreter lock
            shared = SharedProgress(listener, "calibrate", len(arms), total)
            tasks = {
                name: pool.submit(train_arm, profile, arm, readings[name], cancel, shared.part(f"arm {name}"))
                for name, arm in arms.items()
            }
            for name, task in tasks.items():
                arms[name] = task.result()
    listener(Progress("calibrate", total - 1, total, "pair"))
    cancel.check()
    pair, pair_notes = calibrate_pair(profile, readings, arms)
    notes += pair_notes
    names = tuple(profile.arms)
    provenance = provenance_of(profile)
    model = CellModel(
        arms={name: arm.model for name, arm in arms.items()},
        T_R_L=None if pair is None else pair.T_R_L,
        pair=None if pair is None else (names[0], names[1]),
        provenance=provenance.model_dump(),
    )
    listener(Progress("calibrate", total, total, "done"))
    return Calibration(model, arms, pair, tuple(notes), provenance)


def provenance_of(profile: Profile) -> Provenance:
    """The provenance of a model that is made now."""
    return Provenance(
        profile=profile.name,
        seed=profile.seed,
        program=program_of(profile),
        python=platform.python_version(),
        numpy=np.__version__,
        written=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def missing_splits(
    profile: Profile, readings: Mapping[str, Readings]
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """Splits of readings of which none has one yet, and notes; empty where some have."""
    if any(word is not None for arm in readings.values() for word in arm.split or ()):
        return {}, ()
    return profile_splits(profile, readings)


def profile_splits(
    profile: Profile, readings: Mapping[str, Readings]
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """A split for each reading of each arm, the same for all arms at a stop, drawn by the profile's seed; and notes."""
    splits = profile.splits
    numbers = np.concatenate([arm.configuration for arm in readings.values()])
    validate = None if splits.validate_ == "rest" else splits.validate_
    drawn, notes = draw_splits(numbers, splits.identify, splits.train, validate, profile.seed)
    words = {name: tuple(drawn[number] for number in arm.configuration.tolist()) for name, arm in readings.items()}
    return words, notes


def calibrate_arm(profile: Profile, name: str, readings: Readings) -> tuple[ArmCalibration, list[str]]:
    """Identify one arm on its identify split, evaluate it on its validate split; and notes."""
    arm = profile.arms[name]
    identify_rows, validate_rows = readings.in_split("identify"), readings.in_split("validate")
    if len(identify_rows) < 4 or len(validate_rows) < 1:
        raise InputError(
            f"arm '{name}': {len(readings)} readings leave {len(identify_rows)} to identify and {len(validate_rows)} to"
            f" validate; at least 4 and 1 are needed to begin with: measure more configurations"
        )
    learn, held_out = readings.take(identify_rows), readings.take(validate_rows)
    nominal = start_from_nominal(nominal_arm(arm), learn.q, learn.p_M, tool_unknown=arm.smr.offset == "unknown")
    identification, excess = _identify(profile, name, nominal, learn)
    model = ArmModel(
        geometry=identification.geometry,
        nominal=nominal,
        bodies=bodies_of(arm),
        up_M=up_in_tracker(profile),
        smr_normal=np.array(arm.smr.normal, dtype=np.float64),
        identified=identification.estimated.names,
        covariance=identification.estimated_covariance,
    )
    stages: dict[Stage, StageErrors] = {
        "nominal": evaluate(held_out.p_M, smr_positions(nominal, held_out.q)),
        "geometry": evaluate(held_out.p_M, smr_positions(identification.geometry, held_out.q)),
    }
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
        counts={word: len(readings.in_split(word)) for word in SPLITS},
        repeatability=repeatability(readings.q, readings.p_M),
        tracker_mm=None if stated is None else rms_length_mm(stated),
    )
    return calibration, notes


def _identify(profile: Profile, name: str, nominal: Geometry, learn: Readings) -> tuple[Identification, float]:
    """Identify one arm as the profile says; also its excess scatter [m]."""
    settings = profile.calibration
    try:
        return identify_with_excess(
            nominal,
            learn.q,
            learn.p_M,
            sigma=stated_uncertainty(learn),
            parameter_set=settings.parameter_set,
            prior_sigma=prior_sigmas(nominal, settings.priors),
            robust=settings.robust,
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )
    except TooFewReadings as error:
        raise InputError(f"arm '{name}': {error}") from None
    except ValueError as error:
        raise InputError(f"arm '{name}': calibration.parameter_set: {error}") from None


def train_arm(
    profile: Profile,
    arm: ArmCalibration,
    readings: Readings,
    cancel: CancelToken | None = None,
    report: Report = ignore_report,
) -> ArmCalibration:
    """Train the residual network of an arm in its base frame, and the same in the tracker frame for comparison.

    The training data are the train split, or the identify split where there is no train split.
    """
    rows = readings.in_split("train")
    learn = readings.take(rows if len(rows) else readings.in_split("identify"))
    held_out = readings.take(readings.in_split("validate"))
    if len(learn) < 2 * profile.network.folds:
        return arm
    rotation = arm.model.geometry.T_M_B()[:3, :3]
    left_M = learn.p_M - arm.model.predict(learn.q, learn.approach, learn.payload_kg)

    def train(residual: Array, shapes: Sequence[Shape] | None, first: int, frame: str) -> Training:
        return train_network(
            learn.q,
            residual,
            seed=profile.seed,
            folds=profile.network.folds,
            iterations=profile.network.iterations,
            shapes=shapes,
            cancel=cancel,
            report=lambda done, words: report(first + done, f"{frame}: {words}"),
        )

    training = train(left_M @ rotation, None, 0, "base frame")
    if training.network is None:
        return replace(arm, training=training)
    # the same layer, in a frame that does not rotate with joint 1: the tracker frame has no relation to that axis
    in_tracker = train(
        left_M, (replace(training.shape, rotates_with_joint_1=False),), _BASE_STEPS, "tracker frame"
    ).network
    model = replace(arm.model, network=training.network)
    computed = model.predict(held_out.q, held_out.approach, held_out.payload_kg)
    stages: dict[Stage, StageErrors] = {**arm.validate, "network": evaluate(held_out.p_M, computed)}
    return replace(arm, model=model, validate=stages, training=training, tracker_frame_network=in_tracker)


def rms_length_mm(sigma: Array) -> float:
    """Root mean square length of the stated noise, from sigmas (n,) [m] or covariances (n, 3, 3) [m^2]."""
    squares = 3.0 * sigma**2 if sigma.ndim == 1 else np.trace(sigma, axis1=1, axis2=2)
    return float(np.sqrt(squares.mean())) * 1e3
