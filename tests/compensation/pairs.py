"""Commands of cooperative targets, made from stops of a run's plan: safe and visible for both arms at once."""

from __future__ import annotations

import numpy as np

from cellapp.compensation.command import Command, Prediction
from cellapp.compensation.targets import Partner, Target
from cellapp.kinematics.inverse import solve_pose
from cellapp.kinematics.transforms import Array
from cellapp.model import CellModel
from cellapp.results import UncertaintyParts
from cellapp.run import RunFile

PARTS = UncertaintyParts(parameters=0.02, effects=0.01, network=0.0, extrapolation=0.0, noise=0.03, conditions=0.0)
PREDICTION = Prediction(uncertainty_mm=0.03, parts=PARTS, within_mm=0.1, unknown=(), offered_approach=None, verdict="")


def pair_commands(run: RunFile, model: CellModel, stops: list[int], tolerance: float | None = None) -> list[Command]:
    """One target for each stop, wanted where the model expects the SMRs there; a command for each arm."""
    plan = run.read_plan()
    assert plan is not None
    commands = []
    for stop in stops:
        target = Target(
            name=f"pair-{stop}",
            arm="left",
            position=(0.0, 0.0, 0.0),
            frame="tracker",
            tolerance=tolerance,
            partner=Partner(arm="right", position=(0.0, 0.0, 0.0)),
        )
        commands += [_command(model, target, name, plan[name][stop]) for name in ("left", "right")]
    return commands


def _command(model: CellModel, target: Target, name: str, q: Array) -> Command:
    arm = model.arms[name]
    p_M = arm.predict(q[None])
    rotation_M, _ = arm.flange(q[None])
    nominal = solve_pose(arm.nominal, p_M, rotation_M, q[None])
    assert nominal.reached[0]
    return Command(target, name, np.asarray(nominal.q[0]), q, p_M[0], p_M[0], "", prediction=PREDICTION)
