"""Whether a residual network of the rotation is worth having: trained like that of positions, judged on held-out rows.

    python -m tests.trials.turn_network --data READINGS.csv --profile profiles/ur10-6d.yaml
    python -m tests.trials.turn_network

The second is of simulated arms of ``kinds``. 300 rows are learned from, at most three quarters of all.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from cellapp.cell.profile import load_profile
from cellapp.cell.run import read_readings_csv
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.measurement_conditions import measurement_conditions
from cellapp.estimation.calibration.network_training import train_network
from cellapp.estimation.calibration.quantities import measured_quantities
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.model import ArmModel
from tests.trials.kinds import KINDS, Array, Bench

LEARNED, SIMULATED = 300, 400
app = typer.Typer(add_completion=False)


def turns_left(model: ArmModel, readings: Readings) -> tuple[Array, Array]:
    """Joint positions (n, N) [rad], and rotations (n, 3) from computed to measured orientations in B [rad]."""
    its = measured_quantities(readings, measurement_conditions(readings))
    assert its.turned is not None
    rows = np.flatnonzero(its.turned)
    q = its.readings.q[rows]
    left_M = -model.predict(q, conditions=its.conditions.take(rows))
    return q, left_M @ model.geometry.T_M_B()[:3, :3]


def trial(profile: Profile, readings: Readings, seed: int) -> tuple[float, float]:
    """Mean held-out error of the orientation [mrad] with geometry alone, and with a network of what that leaves."""
    (name,) = profile.arms
    order = np.random.default_rng([seed, 51]).permutation(len(readings))
    learned = order[: min(LEARNED, 3 * len(order) // 4)]
    words = np.full(len(readings), "validate", dtype=object)
    words[learned] = "identify"
    readings = replace(readings, split=tuple(words.tolist()))
    arm, _ = calibrate_arm(profile, name, readings)
    (q, left), (q_new, left_new) = (
        turns_left(arm.model, readings.take(readings.in_split(split))) for split in ("identify", "validate")
    )
    network = train_network(q, left, seed=seed).network
    corrected = left_new if network is None else left_new - network.correct(q_new)
    before, after = (1e3 * float(np.linalg.norm(one, axis=1).mean()) for one in (left_new, corrected))
    return before, after


def simulated(seed: int) -> tuple[Profile, Readings]:
    """A simulated arm with a probe, and its readings."""
    bench = Bench(seed, SIMULATED)
    profile = bench.profile(**KINDS["6-D probe"])
    return profile, bench.measured(profile)


def of_file(path: Path, data: Path) -> tuple[Profile, Readings]:
    """A real arm and its readings."""
    profile = load_profile(path)
    (name,) = profile.arms
    return profile, read_readings_csv(data, {name: len(profile.arms[name].type.joints)}, in_order=True)[0][name]


@app.command()
def main(
    data: Annotated[Path | None, typer.Option(help="readings of a real arm")] = None,
    profile: Annotated[Path | None, typer.Option(help="its profile")] = None,
    seeds: Annotated[int, typer.Option(min=1)] = 3,
) -> None:
    """Print a line for each draw."""
    real = None if data is None or profile is None else of_file(profile, data)
    for seed in range(1, seeds + 1):
        its, readings = real or simulated(seed)
        before, after = trial(its, readings, seed)
        typer.echo(f"draw {seed}: geometry {before:.3f} mrad, with a network of the rotation {after:.3f} mrad")


if __name__ == "__main__":
    app()
