"""Runs of one cell over time, made by the product from readings of a chain whose geometry and backlash are known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import DiscoverySettings, Profile
from cellapp.ground.profile.sections import Tolerances, Traceability, TraceableArm
from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import STATION, true_geometry
from tests.cell.run.small_runs import alter_file
from tests.interfaces.page.runs import without_devices

SIGMA_M = 15e-6
STOPS = 90


@dataclass(frozen=True)
class Truth:
    """What is true of both arms in one run: added to parameters [m, rad], and play of joints 1 to 3 [rad]."""

    added: tuple[tuple[str, float], ...] = ()
    half_play: float = 0.0


def cell(seed: int = 1, *, serials: tuple[str, str] | None = None, tolerance_m: float | None = None) -> Profile:
    """Two arms without devices; ``serials`` are given in the profile."""
    without = without_devices("left", "right")
    profile = without.model_copy(update={"name": "cell", "seed": seed, "discovery": DiscoverySettings()})
    if serials is not None:
        arms = {name: TraceableArm(serial=serial) for name, serial in zip(profile.arms, serials)}
        profile = profile.model_copy(update={"traceability": Traceability(arms=arms)})
    if tolerance_m is not None:
        profile = profile.model_copy(update={"tolerances": Tolerances(position=tolerance_m)})
    return profile


def measured_run(
    folder: Path, seed: int, truth: Truth | None = None, *, profile: Profile | None = None, search: bool = False
) -> Path:
    """A run with other stops and other noise for every ``seed``, calibrated and, with ``search``, searched."""
    truth = truth or Truth()
    geometry_rng, rng = np.random.default_rng(0), np.random.default_rng([3, seed])
    with RunFile.create(folder, profile or cell(seed)) as run:
        for place, (name, arm) in enumerate(run.profile.arms.items()):
            station = STATION.copy()
            station[0, 3] += 1.5 * place
            true = true_geometry(nominal_arm(arm).with_T_M_B(station), geometry_rng)
            names, vector = parameter_names(true.joints), true.vector()
            if name == "left":
                for parameter, value in truth.added:
                    vector[names.index(parameter)] += value
            q = rng.uniform(-2.5, 2.5, (STOPS, 6))
            approach = rng.choice([-1, 1], (STOPS, 6)).astype(np.int8)
            play = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * (truth.half_play if name == "left" else 0.0)
            run.add_readings(
                name,
                Readings(
                    configuration=np.arange(STOPS, dtype=np.int64),
                    time_s=np.arange(float(STOPS)),
                    q=q,
                    approach=approach,
                    p_M=smr_positions(true.with_vector(vector), q - approach * play)
                    + rng.normal(0.0, SIGMA_M, (STOPS, 3)),
                    sigma_m=np.full(STOPS, SIGMA_M),
                ),
            )
        calibrate_run(run)
        if search:
            discover_run(run)
    return folder


def set_month(folder: Path, month: int) -> None:
    """Let a run have been made on a day of a month since January 2026."""
    year, in_year = divmod(month, 12)
    written = f"{2026 + year}-{in_year + 1:02}-05T08:00:00.000+00:00"
    for what in ("meta SET value = ? WHERE key = 'created'", "session SET began = ?", "stage SET written = ?"):
        alter_file(folder, f"UPDATE {what}", written)
