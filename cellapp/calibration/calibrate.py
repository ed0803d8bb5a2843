"""The verb: from the readings of a run to a calibrated cell and the numbers that say how good it is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

import cellapp
from cellapp.calibration.evaluation import evaluate, summarise
from cellapp.calibration.identification import (
    Identification,
    TooFewReadings,
    identify_with_excess,
    start_from_nominal,
)
from cellapp.calibration.pair import PAIR_NAMES, PairIdentification, distances, identify_pair
from cellapp.calibration.setup import (
    bodies_of,
    nominal_arm,
    prior_sigmas,
    stated_uncertainty,
    up_in_tracker,
)
from cellapp.calibration.splits import draw_splits
from cellapp.errors import InputError
from cellapp.kinematics.chain import Geometry, smr_positions
from cellapp.kinematics.transforms import Array, invert
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings, RunFile

CALIBRATION_FILE = "calibration.json"
RESULT = "calibrate"


@dataclass(frozen=True)
class ArmCalibration:
    """One arm's calibration: the model, how it was identified, and its errors on held-out stops by stage.

    ``excess_m`` is the standard deviation of a coordinate [m] beyond what the readings state of themselves.
    """

    model: ArmModel
    identification: Identification
    excess_m: float
    validate: Mapping[str, Mapping[str, Mapping[str, float | int]]]
    counts: Mapping[str, int]


@dataclass(frozen=True)
class PairCalibration:
    """The pair: the inter-base transform and cooperative errors by method; or why there is none."""

    identification: PairIdentification
    cooperative: Mapping[str, Mapping[str, float | int]]
    counts: Mapping[str, int]


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
            "pair": {} if self.pair is None else _pair_dict(self.pair),
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
    total = len(readings) + 1
    arms: dict[str, ArmCalibration] = {}
    for done, (name, arm_readings) in enumerate(readings.items()):
        listener(Progress("calibrate", done, total, f"arm {name}"))
        cancel.check()
        arms[name], arm_notes = calibrate_arm(profile, name, arm_readings)
        notes += arm_notes
    listener(Progress("calibrate", total - 1, total, "pair"))
    cancel.check()
    pair, pair_note = _calibrate_pair(profile, readings, {name: arm.model for name, arm in arms.items()})
    notes += pair_note
    names = tuple(profile.arms)
    model = CellModel(
        arms={name: arm.model for name, arm in arms.items()},
        T_R_L=None if pair is None else pair.identification.T_R_L,
        pair=None if pair is None else (names[0], names[1]),
        provenance={
            "profile": profile.name,
            "seed": profile.seed,
            "program": f"cellapp {cellapp.__version__}",
            "numpy": np.__version__,
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    )
    calibration = Calibration(model, arms, pair, tuple(notes))
    store(run, calibration)
    listener(Progress("calibrate", total, total, "done"))
    return calibration


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
    splits = profile.splits
    numbers = np.concatenate([arm.configuration for arm in readings.values()])
    validate = None if splits.validate_ == "rest" else splits.validate_
    drawn, notes = draw_splits(numbers, splits.identify, splits.train, validate, profile.seed)
    for name, arm in readings.items():
        run.assign_splits(name, [drawn[number] for number in arm.configuration.tolist()])
    return notes


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
        identified=identification.names,
        covariance=identification.covariance,
    )
    stages = {
        "nominal": evaluate(held_out.p_M, smr_positions(nominal, held_out.q)),
        "geometry": evaluate(held_out.p_M, smr_positions(identification.geometry, held_out.q)),
    }
    counts = {word: len(readings.in_split(word)) for word in ("identify", "train", "validate")}
    notes = [] if identification.converged else [f"arm '{name}': {identification.message}; do not use this calibration"]
    return ArmCalibration(model, identification, excess, stages, counts), notes


def nominal_transform(first: Geometry, second: Geometry) -> Array:
    """``T_second_first`` (4, 4) of two bases that both stand in the tracker frame."""
    return np.asarray(invert(second.T_M_B()) @ first.T_M_B())


def common_stops(first: Readings, second: Readings) -> tuple[Readings, Readings]:
    """The readings of two arms at their common stops, in the same order."""
    _, i, k = np.intersect1d(first.configuration, second.configuration, return_indices=True)
    return first.take(i), second.take(k)


def _calibrate_pair(
    profile: Profile, readings: Mapping[str, Readings], models: Mapping[str, ArmModel]
) -> tuple[PairCalibration | None, list[str]]:
    if len(readings) != 2:
        return None, [f"pair: skipped, the profile has {len(readings)} arm(s)"]
    (left, right), (left_model, right_model) = readings.values(), models.values()
    both = common_stops(left, right)
    held_out = both[0].in_split("validate")
    learn = np.setdiff1d(np.arange(len(both[0])), held_out)
    draw = np.random.default_rng([profile.seed, 0xBA5E])
    learn = np.sort(draw.permutation(learn)[: profile.splits.pair_identify])
    held_out = np.sort(draw.permutation(held_out)[: profile.splits.pair_validate])
    if len(learn) < 7 or len(held_out) < 1:
        return None, [
            f"pair: skipped, {len(both[0])} common stops leave {len(learn)} to identify and {len(held_out)} to"
            " validate; 7 and 1 are needed"
        ]
    notes = []
    if len(learn) < profile.splits.pair_identify or len(held_out) < profile.splits.pair_validate:
        notes.append(f"pair: {len(learn)} stops to identify and {len(held_out)} to validate are fewer than asked for")
    measured = np.linalg.norm(both[0].p_M - both[1].p_M, axis=1)
    start = nominal_transform(left_model.geometry, right_model.geometry)
    p_L = left_model.in_base().predict(both[0].q, both[0].approach, both[0].payload_kg)
    p_R = right_model.in_base().predict(both[1].q, both[1].approach, both[1].payload_kg)
    identification = identify_pair(start, p_L[learn], p_R[learn], measured[learn])
    if not identification.converged:
        notes.append("pair: the inter-base transform did not converge; do not use it")
    nominal = nominal_transform(left_model.nominal, right_model.nominal)
    p_L_nominal = smr_positions(left_model.nominal.with_T_M_B(np.eye(4)), both[0].q)
    p_R_nominal = smr_positions(right_model.nominal.with_T_M_B(np.eye(4)), both[1].q)
    errors = {
        "nominal": measured - distances(nominal, p_L_nominal, p_R_nominal),
        "method_1": measured - distances(identification.T_R_L, p_L, p_R),
    }
    cooperative = {method: summarise(error[held_out]).as_dict() for method, error in errors.items()}
    return PairCalibration(identification, cooperative, {"identify": len(learn), "validate": len(held_out)}), notes


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
        "validate": {stage: dict(errors) for stage, errors in arm.validate.items()},
    }


def _pair_dict(pair: PairCalibration) -> dict[str, Any]:
    found = pair.identification
    methods: dict[str, Any] = {method: {"cooperative_mm": errors} for method, errors in pair.cooperative.items()}
    methods["method_1"]["identified"] = {
        name: {"value": value, "standard_error": error, "unit": "m" if name in "xyz" else "rad"}
        for name, value, error in zip(PAIR_NAMES, found.values.tolist(), found.standard_errors.tolist(), strict=True)
    }
    methods["method_1"]["iterations"] = found.iterations
    methods["method_1"]["converged"] = found.converged
    methods["method_1"]["splits"] = dict(pair.counts)
    return methods
