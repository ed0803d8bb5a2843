"""Time and error of a network from 100 000 readings beside the committee: ``python -m tests.benchmarks.learning``."""

from __future__ import annotations

import argparse
import time

import numpy as np

from cellapp.estimation.calibration.learning import learn
from cellapp.ground.profile import Network
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.model.network import rotate_about_z

NOISE_M = 15e-6


def residual(q):
    """Slow parts of posture, and one of eight cycles a turn [m]."""
    sag = 2e-4 * np.cos(q[:, 1]) + 1e-4 * np.sin(q[:, 1] + q[:, 2]) + 5e-5 * np.sin(8.0 * q[:, 2]) * np.cos(q[:, 1])
    return rotate_about_z(np.stack([sag, 0.3 * sag, -sag], axis=1), q[:, 0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    q, new = rng.uniform(-2.5, 2.5, (asked.readings, 6)), rng.uniform(-2.5, 2.5, (5000, 6))
    measured = residual(q) + rng.normal(0.0, NOISE_M, (len(q), 3))
    for kind in ("mlp", "batches"):
        began, used = time.perf_counter(), time.process_time()
        with one_blas_thread():
            training = learn(Network(kind=kind), q, measured, np.arange(float(len(q))), seed=asked.seed)
        wall, cpu = time.perf_counter() - began, time.process_time() - used
        left = residual(new) - (0.0 if training.network is None else training.network.correct(new))
        rms_um = 1e6 * np.sqrt(np.mean(np.sum(left**2, axis=1)))
        print(f"{kind}: {wall:.1f} s, {cpu:.1f} s of processor; error at 5000 new postures {rms_um:.1f} um rms")  # noqa: T201


if __name__ == "__main__":
    main()
