"""``calibrate``: readings in, result and model out; the command and the library call this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from cellapp.commands.calibrate.result import calibrate_result
from cellapp.estimation.calibration.calibrate import calibrate_readings
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.prior.calibrate import with_prior
from cellapp.estimation.prior.earlier import Earlier
from cellapp.estimation.readings import Readings
from cellapp.ground.blas import one_blas_thread
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore, with_eta
from cellapp.robot.model import CellModel


def calibrate_cell(
    profile: Profile,
    readings: Mapping[str, Readings],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    earlier: Mapping[str, Earlier] | None = None,
    notes: Sequence[str] = (),
) -> tuple[CalibrateResult, CellModel]:
    """Calibrate a cell from readings whose splits are drawn.

    ``earlier`` calibrations of arms are taken as prior. ``notes`` come before those of the calibration.

    Raises
    ------
    InputError
        If an arm has too few readings.
    Cancelled
        On request.
    """
    with one_blas_thread():
        found = calibrate_readings(profile, readings, with_eta(listener), cancel)
        if earlier:
            found = with_prior(profile, readings, found, earlier)
    return calibrate_result(replace(found, notes=(*notes, *found.notes))), found.model
