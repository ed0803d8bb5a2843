"""A random linear problem with two candidate laws beside ten nuisance parameters, and searches of runs in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.cell.planning.propose import Effort, Proposal, propose_stops
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.design.information import NuisanceProjector
from cellapp.estimation.discovery.arm_data import ArmData, CandidateLaw, LawScore
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.estimation.discovery.joint_fit import ProjectedResidual
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.ground.profile import Profile
from cellapp.robot.effects import ActsOn, EffectColumn, LawForm
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.series import readings_at

N = 300
"""Coordinates."""
PLAIN = LawForm("", "plain")


@dataclass(frozen=True, eq=False)
class Problem:
    """``design`` (N, 10), two candidates and their scan, and the generator that goes on from there."""

    rng: np.random.Generator
    design: np.ndarray
    projector: NuisanceProjector
    first: CandidateLaw
    scan: LawScan

    def noise(self) -> np.ndarray:
        return self.rng.normal(size=N)

    def visible(self, y: np.ndarray) -> np.ndarray:
        """A residual as a fit leaves it: without what the nuisance parameters explain."""
        return self.projector.project(y)

    def residual(self, y: np.ndarray) -> ProjectedResidual:
        return ProjectedResidual(self.projector, y)

    def scan_of(self, *candidates: CandidateLaw) -> LawScan:
        return LawScan.of(candidates, self.projector)

    def ranked(self, y: np.ndarray, scan: LawScan | None = None) -> list[LawScore]:
        return (scan or self.scan).ranked(self.residual(y))


def problem(seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(N, 10))
    columns = (column("a", "one"), column("b", "one"), column("c", "two"))
    first = CandidateLaw("first", PLAIN.law(), columns, rng.normal(size=(3, N)))
    second = CandidateLaw("second", PLAIN.law(), (column("d", "three"), column("e", "four")), rng.normal(size=(2, N)))
    projector = NuisanceProjector.of(design.T)
    return Problem(rng, design, projector, first, LawScan.of([first, second], projector))


def column(name: str, block: str, *, refines: bool = False) -> EffectColumn:
    return EffectColumn(name, "rad", block, -1.0, 1.0, ActsOn.BASE, refines=refines)


def refining_law(rng: np.random.Generator, main: np.ndarray) -> CandidateLaw:
    """A law of two main blocks and two that only refine them."""
    columns = (
        column("a", "one"),
        column("b", "two"),
        column("c", "three", refines=True),
        column("d", "four", refines=True),
    )
    return CandidateLaw("refined", PLAIN.law(), columns, np.stack([main, *rng.normal(size=(3, N))]))


def arm_of(profile: Profile, geometry: Geometry | None = None) -> ArmModel:
    """The left arm of the twin at its station, as it was built."""
    arm = profile.arms["left"]
    geometry = geometry or nominal_arm(arm).with_T_M_B(STATION)
    return ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(arm), up_M=STATION[:3, 2])


def data_of(
    profile: Profile, q: Array, approach: Array, p_M: Array, sigma_m: float | None, time_s: Array | None = None
) -> ArmData:
    """Readings of the left arm; no times if None."""
    readings = readings_at(q, p_M, time_s=time_s, approach=approach, sigma_m=sigma_m)
    return ArmData.of(ArmReadings.alone(profile, "left", arm_of(profile), readings))


def only(joint: int, values: Array) -> Array:
    """Offsets (n, 6) of one joint, counted from 1."""
    return values[:, None] * (np.arange(1, 7) == joint)


def calibrated_and_searched(run: RunFile) -> CellDiscovery:
    """Draw splits, calibrate, search every arm."""
    calibrate_run(run)
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    return discover_cell(run.profile, model, {name: run.readings(name) for name in model.arms})


def proposed(run: RunFile, found: CellDiscovery, count: int, effort: Effort) -> Proposal:
    """Further stops after a search; the plan stays as it is."""
    readings = {name: run.readings(name) for name in found.arms}
    return propose_stops(run.profile, found.model, readings, found.arms, count, effort=effort)
