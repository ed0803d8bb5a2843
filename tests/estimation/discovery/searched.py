"""Calibrate and search a run in memory; returns the objects of discovery."""

from __future__ import annotations

from cellapp.cell.planning.proposal.arm_candidates import Effort
from cellapp.cell.planning.proposal.propose import Proposal, propose_stops
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.robot.model import CellModel


def calibrated_and_searched(run: RunFile) -> CellDiscovery:
    """Draw splits, calibrate, search every arm."""
    calibrate_run(run)
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    return discover_cell(run.profile, model, {name: run.readings(name) for name in model.arms})


def proposed(run: RunFile, found: CellDiscovery, count: int, effort: Effort) -> Proposal:
    """Further stops after a search; the plan stays as it is."""
    readings = {name: run.readings(name) for name in found.arms}
    return propose_stops(run.profile, found.model, readings, found.arms, count, effort=effort)
