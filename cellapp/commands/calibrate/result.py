"""Conversion of a calibration to the result of ``calibrate``."""

from __future__ import annotations

import math
from typing import cast

from cellapp.estimation.calibration.calibrate import ArmCalibration, CellCalibration
from cellapp.estimation.calibration.network_training import NetForm, Training
from cellapp.estimation.calibration.pair_calibration import PAIR_NAMES, PairCalibration, PairMethod
from cellapp.estimation.calibration.quantities import summarise
from cellapp.estimation.calibration.records import (
    ArmCalibrationResult,
    CalibrateResult,
    NetworkResult,
    NetworkTrial,
    PairEstimate,
    PairHeldOut,
    PairMethodResult,
    ParameterEstimate,
    Scatter,
    largest_correlations,
    tied_estimates,
)
from cellapp.ground.results import Method
from cellapp.robot.kinematics.chain import parameter_unit
from cellapp.robot.kinematics.transforms import zyx_angles
from cellapp.robot.model.nominal import FIXED_SD

_SCATTER = "root of chi-square per degree of freedom against the stated uncertainty, or metres without one"


def calibrate_result(calibration: CellCalibration) -> CalibrateResult:
    """Build the object that ``calibrate --json`` writes and the run file stores."""
    return CalibrateResult(
        arms={name: arm_result(arm) for name, arm in calibration.arms.items()},
        pair={} if calibration.pair is None else pair_result(calibration.pair),
        notes=calibration.notes,
        provenance=calibration.provenance,
    )


def arm_result(arm: ArmCalibration) -> ArmCalibrationResult:
    """Build the result of one arm."""
    found = arm.identification
    estimates = zip(found.names, found.values.tolist(), found.standard_errors.tolist(), found.units, strict=True)
    both = (arm.model.nominal, found.geometry)
    nominal, values = (dict(zip(its.names, its.vector().tolist(), strict=True)) for its in both)
    fixed = {name: nominal[name] for name, sd in found.prior_sigma.items() if sd <= FIXED_SD}
    related, at_bound = largest_correlations(found.names, found.covariance), found.geometry.at_bound
    identified = {
        name: ParameterEstimate(
            value=value,
            standard_error=error,
            unit=unit,
            nominal=nominal.get(name),
            prior_sigma=found.prior_sigma.get(name),
            correlations=related[name],
        )
        for name, value, error, unit in estimates
        if name not in {*fixed, *at_bound}
    }
    for name in filter(at_bound.__contains__, found.estimated.names):
        identified[name] = ParameterEstimate(
            value=values[name], standard_error=None, unit=parameter_unit(name), nominal=nominal[name], at_bound=True
        )
    identified |= tied_estimates(identified, found.geometry.tied_to, nominal)
    merged = {name: its for name, its in found.parameter_set.merged.items() if name not in {*fixed, *at_bound}}
    merged |= {name: merged[first] for name, first in found.geometry.tied_to.items() if first in merged}
    return ArmCalibrationResult.like(
        found,
        identified=identified,
        rank=len(found.parameter_set.columns),
        parameter_set=found.parameter_set.name,
        merged=merged,
        fixed=fixed or None,
        condition=found.condition if math.isfinite(found.condition) else None,
        scatter=Scatter(value=found.scale, meaning=_SCATTER),
        excess_mm=arm.excess_m * 1e3,
        excess_mrad=None if found.angular is None else found.excess_rad * 1e3,
        splits=arm.counts,
        tracker_mm=arm.tracker_mm,
        probe_mrad=arm.probe_mrad,
        repeatability_mm=arm.repeatability,
        network=None if arm.training is None else _network(arm.training),
        prior=arm.prior,
        left_out_configurations=arm.left_out,
        left_out_splits=arm.left_out_counts,
        validate_=arm.validate,
        clocks=arm.clocks,
        motion=arm.motion,
    )


def pair_result(pair: PairCalibration) -> dict[Method, PairMethodResult]:
    """Build the results of the pair by method."""
    return {name: _method(method, pair) for name, method in pair.methods.items()}


def _network(training: Training) -> NetworkResult:
    batches = training.batches
    of_all = batches is not None and batches.used
    return NetworkResult(
        used=training.network is not None,
        inputs="both" if of_all else training.shape.inputs,
        hidden=batches.hidden if batches is not None and of_all else (training.shape.hidden,),
        turning=training.shape.rotates_with_joint_1,
        left_out_rms_mm=training.left_out_rms * 1e3,
        without_rms_mm=training.without_rms * 1e3,
        tried=tuple(_trial(shape, error) for shape, error in training.tried),
        batches=batches,
    )


def _trial(shape: NetForm, left_out_rms_m: float) -> NetworkTrial:
    return NetworkTrial(
        inputs=shape.inputs,
        hidden=(shape.hidden,),
        turning=shape.rotates_with_joint_1,
        left_out_rms_mm=left_out_rms_m * 1e3,
    )


def _method(method: PairMethod, pair: PairCalibration) -> PairMethodResult:
    found, tracker = method.identification, method.T_R_L_tracker
    by_tracker = [*tracker[:3, 3].tolist(), *zyx_angles(tracker[:3, :3])]
    estimates = zip(PAIR_NAMES, found.values.tolist(), found.standard_errors.tolist(), by_tracker, strict=True)
    summaries = {key: summarise(errors) for key, errors in method.errors.items()}
    rotated = {key: summarise(angles) for key, angles in method.rotated.items()}
    return PairMethodResult(
        cooperative_mm=summaries[pair.chosen],
        cooperative_mrad=rotated.get(pair.chosen),
        transform=pair.chosen,
        by_transform_mm=summaries,
        by_transform_mrad=rotated or None,
        identified={
            name: PairEstimate(
                value=value, standard_error=error, unit="m" if name in "xyz" else "rad", by_tracker=other
            )
            for name, value, error, other in estimates
        },
        iterations=found.iterations,
        converged=True,  # else it was refused; earlier versions stored such a pair
        splits=pair.counts,
        held_out=PairHeldOut(
            configuration=tuple(pair.stops.tolist()),
            cooperative_mm=tuple(abs(error) * 1e3 for error in method.errors[pair.chosen].tolist()),
            position_mm={
                arm: tuple(error * 1e3 for error in cast("list[float]", errors.tolist()))
                for arm, errors in method.position_errors.items()
            },
        ),
    )
