"""``discover``: a calibrated model and its readings in, result and extended model out; for command and library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cellapp.commands.discover.result import discover_result
from cellapp.estimation.calibration.calibrate import provenance_of
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.prior.discovery import SearchWithPriors
from cellapp.estimation.prior.earlier import Earlier
from cellapp.estimation.readings import Readings
from cellapp.ground.blas import one_blas_thread
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore, with_eta
from cellapp.robot.model import CellModel


def discover_effects(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    earlier: Mapping[str, Earlier] | None = None,
) -> tuple[DiscoverResult, CellDiscovery]:
    """Search every arm for missing effects.

    ``model`` is the calibrated one, ``readings`` and ``earlier`` are those of the calibration. The model of the outcome
    has the accepted effects, and its provenance is of now.

    Raises
    ------
    Cancelled
        On request.
    """
    with one_blas_thread():
        search = SearchWithPriors(earlier) if earlier else None
        found = discover_cell(profile, model, readings, with_eta(listener), cancel, search)
    extended = replace(found.model, provenance=provenance_of(profile).model_dump())
    return discover_result(found), replace(found, model=extended)
