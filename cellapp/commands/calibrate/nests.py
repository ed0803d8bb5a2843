"""Several SMRs on a flange: their identified positions, and what they tell of the orientation."""

from __future__ import annotations

import math

import numpy as np

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.nests import has_nests, nest_stops
from cellapp.estimation.calibration.records import CalibrateResult, NestEstimate, NestsResult
from cellapp.estimation.nests.offsets import offsets_by_arm
from cellapp.robot.model import CellModel


def with_nests(result: CalibrateResult, run: RunFile, model: CellModel) -> CalibrateResult:
    """Return the result with the nests of every arm that has readings of several nests."""
    arms = dict(result.arms)
    for name, arm in result.arms.items():
        found = _nests(run, name, model)
        if found is not None:
            arms[name] = arm.model_copy(update={"nests": found})
    return result.model_copy(update={"arms": arms})


def _nests(run: RunFile, name: str, model: CellModel) -> NestsResult | None:
    if not run.profile.arms[name].smr.nests:  # rows can name no other
        return None
    rows = run.rows(name)
    if not has_nests(rows):
        return None
    stops = nest_stops(run.profile, name, rows)
    noise_m = float("nan") if stops.shape is None else stops.shape.noise_m
    sigma_rad = np.zeros(0) if stops.readings.sigma_rad is None else stops.readings.sigma_rad
    known = sigma_rad[np.isfinite(sigma_rad)]
    return NestsResult(
        found={
            nest: NestEstimate(
                offset_m=tuple(one.offset_F.tolist()),
                standard_error_m=tuple(one.standard_error.tolist()),
                n=one.n,
            )
            for nest, one in offsets_by_arm(model.arms[name], rows, stops.groups).items()
        },
        stops=len(stops.left_out),
        with_orientation=len(known),
        left_out=tuple(rows.configuration[stops.groups.first_rows[stops.left_out]].tolist()),
        noise_mm=1e3 * noise_m if math.isfinite(noise_m) else None,
        orientation_mrad=1e3 * math.sqrt(float(np.mean(known**2))) if len(known) else None,
    )
