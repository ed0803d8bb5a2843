"""Do stated intervals hold? Many simulated recordings of an arm, each identified, and how often 95 % hold the truth.

    python -m tests.trials.motion --runs 200 --noise slow

Noise: ``white``; ``slow`` (neighbouring points alike for 0.3 s); ``effects`` (slow noise, play and two cycles a turn of
sizes of their own, of which the fit knows the play only: its intervals of clocks and play are judged).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer

from cellapp.estimation.motion.identify import RecordedArm, identify_from_motion
from cellapp.estimation.motion.records import MotionFit
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.chain import JointAngles, jacobian, nominal_geometry
from tests.estimation.motion.simulated import UR10, Arm, record, sweep, true_arm

app = typer.Typer(add_completion=False)
OFFSET_S, RATE_PPM = 0.0178, -18.0


@dataclass(frozen=True)
class Held:
    """Whether intervals of one run hold: offset, rate, play, coordinates of predicted points; and errors of clocks."""

    offset: bool
    rate: bool
    play: np.ndarray
    points: np.ndarray
    offset_error_s: float
    rate_error_ppm: float


def one_run(seed: int, noise: str, seconds: float) -> Held:
    """Simulate, identify, compare."""
    rng = np.random.default_rng([seed, 0x3071])
    arm = true_arm(rng, half_play=np.full(6, 20e-6))
    if noise == "effects":
        arm = replace(arm, cycles=2.0, amplitude=rng.normal(0.0, 60e-6, 7), phase=rng.uniform(0.0, 6.0, 7))
        arm = replace(arm, half_play=np.abs(rng.normal(0.0, 40e-6, 6)))
    motion = sweep(rng, 6, base_hz=0.02 + 0.01 * rng.random())
    slow = 0.0 if noise == "white" else 40e-6
    recording = record(rng, arm, motion, seconds=seconds, slow=slow, offset=OFFSET_S, rate_ppm=RATE_PPM)
    fit = identify_from_motion(RecordedArm(nominal_geometry(UR10, np.zeros(3)), [recording], tool_unknown=True))
    clock = fit.clocks["sweep"]
    return Held(
        clock.offset_interval_s[0] <= OFFSET_S <= clock.offset_interval_s[1],
        clock.rate_interval_ppm[0] <= RATE_PPM <= clock.rate_interval_ppm[1],
        np.abs(fit.half_play - arm.half_play) < 1.96 * fit.half_play_standard_error,
        _points_hold(fit, arm, motion.at(rng.uniform(0.0, seconds, 5))),
        abs(clock.offset_s - OFFSET_S),
        abs(clock.rate_ppm - RATE_PPM),
    )


def _points_hold(fit: MotionFit, arm: Arm, q: np.ndarray) -> np.ndarray:
    found = fit.identification
    P, J = jacobian(found.geometry, JointAngles.of(q), found.estimated.columns)
    variance = np.einsum("akn,kl,aln->an", J, found.estimated_covariance, J)
    return np.abs(arm.points(q).T - P) < 1.96 * np.sqrt(variance)


def coverage(runs: int, noise: str, seconds: float, first: int = 0) -> dict[str, float]:
    """Share of intervals that hold, by quantity, and the largest errors of the clocks."""
    with one_blas_thread():
        held = [one_run(seed, noise, seconds) for seed in range(first, first + runs)]
    return {
        "offset": float(np.mean([one.offset for one in held])),
        "rate": float(np.mean([one.rate for one in held])),
        "play": float(np.mean([one.play for one in held])),
        "points": float(np.mean([one.points for one in held])),
        "largest offset error [ms]": 1e3 * max(one.offset_error_s for one in held),
        "largest rate error [ppm]": max(one.rate_error_ppm for one in held),
    }


@app.command()
def main(
    runs: Annotated[int, typer.Option(min=1)] = 200,
    noise: Annotated[str, typer.Option(help="white, slow or effects")] = "slow",
    seconds: Annotated[float, typer.Option(min=10.0)] = 120.0,
    first: Annotated[int, typer.Option(min=0, help="first seed")] = 0,
) -> None:
    """Simulate, identify and count the intervals that hold."""
    for name, value in coverage(runs, noise, seconds, first).items():
        typer.echo(f"{name:28s} {value:.3f}")


if __name__ == "__main__":
    app()
