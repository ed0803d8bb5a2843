"""What gross errors cost a calibration: held-out error of the good readings with them over that without them.

    python -m tests.benchmarks.gross_errors [--seeds N] [--network] [--time] [--data FOLDER]

Measured series of real arms and simulated cells; a share of the readings is moved by one length in random directions,
or the points of pairs of stops are exchanged. Prints a table, how many readings of clean series are left out; with
``--time`` how much longer the calibration of a clean cell takes than without looking for gross errors.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.commands.trials.drawn_cell import drawn_cell
from cellapp.commands.trials.league.series import SERIES, load_entrant
from cellapp.commands.trials.measured import measured_plan
from cellapp.estimation.calibration import calibrate
from cellapp.estimation.calibration.calibrate import calibrate_arm, calibrate_readings, train_arm
from cellapp.estimation.calibration.evaluation import position_errors
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.model import ArmModel

ROOT = Path(__file__).parents[2]
SHARES = (0.01, 0.03, 0.05)
KINDS: tuple[float | str, ...] = (3e-4, 1e-3, 1e-2, 1e-1, 1.0, "swapped")
"""Lengths of gross errors [m], and exchanged stops."""
_ROWS = 400
"""Readings drawn of a measured series."""
_STOPS = 300
"""Stops of a simulated cell."""


@dataclass(frozen=True)
class Arm:
    """Clean readings of one arm: a fourth held out."""

    name: str
    profile: Profile
    arm: str
    readings: Readings


def disturbed(
    readings: Readings, share: float, kind: float | str, rng: np.random.Generator
) -> tuple[Readings, NDArray[np.intp]]:
    """The readings with gross errors in a share of their rows, and these rows."""
    rows = rng.permutation(len(readings))[: max(2, round(share * len(readings)))]
    p_M = readings.p_M.copy()
    if isinstance(kind, str):
        rows = rows[: len(rows) // 2 * 2]
        p_M[rows] = p_M[rows.reshape(-1, 2)[:, ::-1].ravel()]
    else:
        direction = rng.standard_normal((len(rows), 3))
        p_M[rows] += kind * direction / np.linalg.norm(direction, axis=1)[:, np.newaxis]
    return replace(readings, p_M=p_M), rows


def with_splits(readings: Readings, *, train: bool) -> Readings:
    """A fourth held out, a fourth to train on if asked, the others to identify."""
    words = ("validate", "identify", "train" if train else "identify", "identify")
    return replace(readings, split=tuple(words[row % 4] for row in range(len(readings))))


def arms(seed: int, data: Path, *, train: bool) -> Iterator[Arm]:
    """Every series and every arm of a simulated cell, drawn by ``seed``."""
    for name in SERIES:
        entrant = load_entrant(name, data, ROOT / "profiles")
        order = np.random.default_rng([seed, 0x6055]).permutation(len(entrant.readings))[:_ROWS]
        yield Arm(name, entrant.profile, entrant.arm, with_splits(entrant.readings.take(order), train=train))
    profile = drawn_cell(load_profile(ROOT / "profiles" / "twin.yaml"), seed)
    for name, readings in simulated(profile, seed).items():
        yield Arm(f"twin {name}", profile, name, with_splits(readings, train=train))


def simulated(profile: Profile, seed: int) -> dict[str, Readings]:
    """Clean readings of a simulated cell."""
    planned = profile.model_copy(update={"plan": profile.plan.model_copy(update={"stops": _STOPS})})
    return measured_plan(planned, plan_stops(planned), seed)


def calibrated(arm: Arm, readings: Readings, *, network: bool) -> tuple[ArmModel, tuple[int, ...]]:
    """The calibrated arm, and the configurations that were left out."""
    profile = arm.profile
    found, _ = calibrate_arm(profile, arm.arm, readings)
    return (train_arm(profile, found, readings) if network else found).model, found.left_out


def seconds(profile: Profile, readings: dict[str, Readings]) -> float:
    """Shortest of some calibrations [s]."""
    took = []
    for _ in range(15 if profile.network.kind == "none" else 3):
        started = time.perf_counter()
        calibrate_readings(profile, readings)
        took.append(time.perf_counter() - started)
    return min(took)


def slowdown() -> tuple[float, float]:
    """Time of a clean cell's calibration over that without looking for gross errors: geometry alone, with networks."""
    profile = drawn_cell(load_profile(ROOT / "profiles" / "twin.yaml"), 0)
    readings = {name: with_splits(its, train=True) for name, its in simulated(profile, 0).items()}
    ratios = []
    for kind in ("none", "mlp"):
        chosen = profile.model_copy(update={"network": profile.network.model_copy(update={"kind": kind})})
        with_search = seconds(chosen, readings)
        with mock.patch.object(calibrate, "gross_errors_of_geometry", return_value=np.zeros(1, dtype=np.bool_)):
            ratios.append(with_search / seconds(chosen, readings))
    return ratios[0], ratios[1]


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--network", action="store_true", help="judge the residual network, not the geometry")
    parser.add_argument("--data", type=Path, default=ROOT / "tests" / "fixtures")
    parser.add_argument("--time", action="store_true", help="only compare times on clean data")
    options = parser.parse_args()
    if options.time:
        sys.stdout.write("time on clean data: {:.2f} times, with networks {:.2f} times\n".format(*slowdown()))
        return
    ratios: dict[tuple[str, float | str], list[float]] = {}
    clean = {"readings": 0, "left out": 0}
    for seed in range(options.seeds):
        for arm in arms(seed, options.data, train=options.network):
            plain, left_out = calibrated(arm, arm.readings, network=options.network)
            clean["readings"] += len(arm.readings)
            clean["left out"] += len(left_out)
            for number, kind in enumerate(KINDS):
                for share in SHARES:
                    rng = np.random.default_rng([seed, number, round(1e3 * share)])
                    spoilt, rows = disturbed(arm.readings, share, kind, rng)
                    model, _ = calibrated(arm, spoilt, network=options.network)
                    good = np.setdiff1d(arm.readings.in_split("validate"), rows)
                    q, p_M = arm.readings.q[good], arm.readings.p_M[good]
                    errors = [float(position_errors(p_M, one.predict(q)).mean()) for one in (model, plain)]
                    ratios.setdefault((arm.name, kind), []).append(errors[0] / errors[1])
    everything = np.concatenate(list(ratios.values()))
    beyond = np.count_nonzero(everything > 1.03)
    lines = [
        f"{name:10} {kind!s:8} mean {np.mean(of_all):.4f}  largest {np.max(of_all):.4f}  n {len(of_all)}"
        for (name, kind), of_all in ratios.items()
    ]
    lines += [
        f"all: mean {everything.mean():.4f}, largest {everything.max():.4f}, {beyond} of {len(everything)} above 1.03",
        f"clean: {clean['left out']} of {clean['readings']} readings left out",
    ]
    sys.stdout.write("\n".join([*lines, ""]))


if __name__ == "__main__":
    main()
