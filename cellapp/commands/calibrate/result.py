"""Conversion of a calibration to the result of ``calibrate``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.estimation.calibration.calibrate import ArmCalibration, CellCalibration
from cellapp.estimation.calibration.records import (
    ArmCalibrationResult,
    CalibrateResult,
    ParameterEstimate,
    Scatter,
    largest_correlations,
    tied_estimates,
)
from cellapp.robot.kinematics.chain import parameter_unit
from cellapp.robot.model.nominal import FIXED_SD

_SCATTER = "root of chi-square per degree of freedom against the stated uncertainty, or metres without one"


def calibrate_result(calibration: CellCalibration, notes: Sequence[str] = ()) -> CalibrateResult:
    """Build the object that ``calibrate --json`` writes and the run file stores; ``notes`` come before its own."""
    return CalibrateResult(
        arms={name: arm_result(arm) for name, arm in calibration.arms.items()},
        pair={} if calibration.pair is None else calibration.pair.methods,
        notes=(*notes, *calibration.notes),
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
        network=None if arm.training is None else arm.training.result,
        prior=arm.prior,
        left_out_configurations=arm.left_out,
        validate_=arm.validate,
        clocks=arm.clocks,
        motion=arm.motion,
    )
