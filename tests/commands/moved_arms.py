"""Recordings of arms of the twin as CSV files, made by tests: known geometry, clocks that differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import Geometry, smr_positions
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import STATION, true_geometry
from tests.cell.run.small_runs import write_columns

OFFSET_S, RATE_PPM, SIGMA_M = 1000.0178, 15.0, 20e-6


def true_arm(profile: Profile, name: str, seed: int = 0) -> Geometry:
    """The true geometry of an arm of this profile, at a station of its own."""
    place = [*profile.arms].index(name)
    station = STATION.copy()
    station[0, 3] += 1.5 * place
    rng = np.random.default_rng([seed, place])
    return true_geometry(nominal_arm(profile.arms[name]).with_T_M_B(station), rng)


def write_recording(
    folder: Path, name: str, true: Geometry, *, seconds: float = 40.0, step_s: float = 0.0
) -> tuple[Path, Path]:
    """Files of joints (125 Hz) and points (100 Hz) of one motion; the tracker's clock jumps by ``step_s`` half way."""
    seed = sum(map(ord, name))
    rng = np.random.default_rng(seed)
    reach, rate, phase = rng.uniform(0.3, 0.6, (2, 6)), rng.uniform(0.2, 0.9, (2, 6)), rng.uniform(0.0, 6.0, (2, 6))
    middle = np.array([0.3, -1.2, 1.0, 0.2, 1.1, 0.1])

    def q(t: np.ndarray) -> np.ndarray:
        return np.asarray(middle + sum(reach[k] * np.sin(np.outer(t, rate[k]) + phase[k]) for k in (0, 1)))

    def qd(t: np.ndarray) -> np.ndarray:
        return np.asarray(sum(reach[k] * rate[k] * np.cos(np.outer(t, rate[k]) + phase[k]) for k in (0, 1)))

    when = np.arange(0.0, seconds, 1.0 / 125.0)
    joints = {"time_s": when}
    joints |= {f"q{j + 1}": q(when)[:, j] for j in range(6)} | {f"qd{j + 1}": qd(when)[:, j] for j in range(6)}
    seen = np.arange(1.0, seconds - 1.0, 1.0 / 100.0)
    p_M = smr_positions(true, q(seen)) + rng.normal(0.0, SIGMA_M, (len(seen), 3))
    stamps = seen + OFFSET_S + 1e-6 * RATE_PPM * (seen - seconds / 2.0) + step_s * (seen > seconds / 2.0)
    points = {"time_s": stamps, **dict(zip(("x_m", "y_m", "z_m"), p_M.T, strict=True))}
    return (write_columns(folder / f"{name}_joints.csv", joints), write_columns(folder / f"{name}_points.csv", points))


def add_arm(path: Path, arm: str) -> Path:
    """Add the column ``arm`` to a file."""
    head, *rows = path.read_text("utf-8").splitlines()
    path.write_text("\n".join([f"{head},arm", *(f"{row},{arm}" for row in rows)]) + "\n", "utf-8")
    return path
