"""Simulated recordings of an arm in motion, joints and points with a clock each, are identified: how often do the
stated 95 % intervals hold the truth? Noise *white*; *slow*: neighbouring points alike for 0.3 s; *effects*: slow noise,
play and two cycles a turn of sizes of their own, of which the fit knows the play only."""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cellapp.estimation.motion.identify import MotionFit, RecordedArm, identify_from_motion
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.chain import JointAngles, jacobian, nominal_geometry
from tests.estimation.motion.simulated import UR10, Arm, record, sweep, true_arm
from tests.evidence.skeleton import Evidence, Share, Table

TITLE = "Intervals of recordings in motion"
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


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=200, help="recordings of each noise")
    parser.add_argument("--noise", default="slow", help="white, slow or effects, separated by commas")
    parser.add_argument("--seconds", type=float, default=120.0)


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {
        f"{noise}, seed {seed}": {"noise": noise, "seed": seed, "seconds": asked.seconds}
        for noise in asked.noise.split(",")
        for seed in range(asked.n)
    }


def one(case: dict[str, Any]) -> dict[str, Any]:
    held = asdict(one_run(case["seed"], case["noise"], case["seconds"]))
    return {"noise": case["noise"], **{key: np.asarray(value).tolist() for key, value in held.items()}}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    rows = []
    for noise, some in grouped((its["noise"], its) for its in results).items():
        held = {key: np.ravel([its[key] for its in some]) for key in ("offset", "rate", "play", "points")}
        shares = [str(Share(int(its.sum()), len(its))) for its in held.values()]
        offset, rate = (max(its[key] for its in some) for key in ("offset_error_s", "rate_error_ppm"))
        rows.append([noise, *shares, f"{1e3 * offset:.3f} ms, {rate:.2f} ppm"])
    columns = ["noise", "offset of the clock", "its rate", "play", "predicted points", "largest errors of the clock"]
    return Evidence({}, [Table("", columns, rows)])
