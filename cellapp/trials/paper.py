"""The paper's comparison of three methods, over many simulated cells instead of one real one.

Every seed is another cell: other true arms, bases, plan, noise and splits; the hidden physics is the profile's. Beside
the three methods of Bai et al. (2023), each seed also carries the tracker round the cell and lays it on its side (as on
a horizontal stand), so that its frame differs in every axis, and asks what the two networks do there: the one trained
in the base frame must still help, the one trained in the tracker frame must not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.calibration.calibrate import ArmCalibration, calibrate_readings
from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import Array, apply, register
from cellapp.planning.plan import plan_stops
from cellapp.profile import Pose, Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings
from cellapp.trials.measured import measured_plan

PAPER_COOPERATIVE_MM = {"method_1": 0.2319, "method_2": 0.4669, "proposed": 0.1676}
_STATIONS = (math.radians(70.0), math.radians(-70.0))


@dataclass(frozen=True)
class PaperTrial:
    """One seed: mean cooperative errors by method [mm], arms' mean position errors by stage, and at the moved station.

    ``moved_mm`` is arm -> {geometry, base_frame, tracker_frame} -> mean position error [mm] at the moved station.
    """

    seed: int
    cooperative_mm: Mapping[str, float]
    position_mm: Mapping[str, Mapping[str, float]]
    moved_mm: Mapping[str, Mapping[str, float]]

    @property
    def gain(self) -> float:
        """How much of method 1's error the proposed method removes."""
        return 1.0 - self.cooperative_mm["proposed"] / self.cooperative_mm["method_1"]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "seed": self.seed,
            "gain": self.gain,
            "cooperative_mm": dict(self.cooperative_mm),
            "position_mm": {name: dict(stages) for name, stages in self.position_mm.items()},
            "moved_mm": {name: dict(ways) for name, ways in self.moved_mm.items()},
        }


def paper_trials(
    profile: Profile, seeds: Sequence[int], listener: Listener = ignore, cancel: CancelToken | None = None
) -> list[PaperTrial]:
    """Run the comparison for every seed."""
    cancel = cancel or CancelToken()
    trials = []
    for done, seed in enumerate(seeds):
        cancel.check()
        listener(Progress("paper", done, len(seeds), f"seed {seed}"))
        trials.append(paper_trial(profile, seed, cancel))
    listener(Progress("paper", len(seeds), len(seeds), "done"))
    return trials


def paper_trial(profile: Profile, seed: int, cancel: CancelToken | None = None) -> PaperTrial:
    """One seed of the comparison. Raises ``ValueError`` if the profile has no plant or not two arms."""
    if profile.plant is None or len(profile.arms) != 2:
        raise ValueError("the comparison needs a simulated cell of two arms")
    profile = profile.model_copy(update={"seed": seed, "plant": profile.plant.model_copy(update={"seed": seed})})
    plan = plan_stops(profile, cancel=cancel)
    readings = measured_plan(profile, plan, seed)
    calibration = calibrate_readings(profile, readings, cancel=cancel)
    if calibration.pair is None:
        raise ValueError("; ".join(calibration.notes))
    methods = calibration.pair.methods
    first = methods["method_1"].by_distances.mean
    cooperative = {
        name: methods[name].by_distances.mean if name in methods else first
        for name in ("nominal", "method_1", "method_2", "proposed")
    }
    elsewhere = _moved(profile, seed)
    there = measured_plan(elsewhere, plan, seed + 1)
    return PaperTrial(
        seed=seed,
        cooperative_mm=cooperative,
        position_mm={
            name: {stage: errors.position_mm.mean for stage, errors in arm.validate.items()}
            for name, arm in calibration.arms.items()
        },
        moved_mm={name: _at_other_station(arm, there[name]) for name, arm in calibration.arms.items()},
    )


def _moved(profile: Profile, seed: int) -> Profile:
    """The same cell with the tracker carried round it to one side and laid on its side."""
    pose = profile.tracker.pose
    if pose is None:
        raise ValueError("the profile does not say where the tracker stands")
    turn = _STATIONS[seed % 2]
    x, y, z = pose.position
    c, s = math.cos(turn), math.sin(turn)
    _, pitch, yaw = pose.rpy
    on_its_side = math.copysign(math.pi / 2.0, turn)
    moved = Pose(position=(c * x - s * y, s * x + c * y, z), rpy=(on_its_side, pitch, yaw + turn))
    return profile.model_copy(update={"tracker": profile.tracker.model_copy(update={"pose": moved})})


def _at_other_station(arm: ArmCalibration, readings: Readings) -> dict[str, float]:
    """Mean errors on held-out stops seen from another station, the base found again there from geometry alone."""
    learn, held_out = readings.in_split("identify"), readings.in_split("validate")
    p_B = smr_positions(arm.model.geometry.with_T_M_B(np.eye(4)), readings.q)
    T_M_B = register(readings.p_M[learn], p_B[learn])
    p_B, q, measured = p_B[held_out], readings.q[held_out], readings.p_M[held_out]

    def mean_mm(computed: Array) -> float:
        return float(np.linalg.norm(measured - computed, axis=1).mean()) * 1e3

    errors = {"geometry": mean_mm(apply(T_M_B, p_B))}
    if arm.model.network is not None:
        errors["base_frame"] = mean_mm(apply(T_M_B, p_B + arm.model.network.correct(q)))
    if arm.tracker_trained is not None:
        errors["tracker_frame"] = mean_mm(apply(T_M_B, p_B) + arm.tracker_trained.correct(q))
    return errors


def summary(trials: Sequence[PaperTrial]) -> dict[str, Any]:
    """The object that ``--json`` writes: median and worst over the seeds, and every seed."""
    gains = [trial.gain for trial in trials]
    methods = {
        name: {
            "median": float(np.median([trial.cooperative_mm[name] for trial in trials])),
            "worst": float(np.max([trial.cooperative_mm[name] for trial in trials])),
            "paper": PAPER_COOPERATIVE_MM.get(name),
        }
        for name in ("nominal", "method_1", "method_2", "proposed")
    }
    return {
        "schema": "cellapp-trials-paper",
        "version": 1,
        "cooperative_mm": methods,
        "gain": {"median": float(np.median(gains)), "worst": float(np.min(gains)), "paper": 0.277},
        "trials": [trial.as_dict() for trial in trials],
    }
