"""Simulated cells that trials draw by a seed, with a mix of hidden effects; their readings and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cellapp.cell.planning.plan import plan_stops
from cellapp.commands.trials.measured import measured_plan
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.model import ArmModel

_STIFFNESS, _PLAY, _CURVE = (6e4, 3e4), 1e-4, 1e-4
"""Hidden effects of the mix: stiffness of every joint of two arms in turn [Nm/rad], play and rms of the gears' curves
[rad]; sizes as in catalogues of strain-wave gears and in measured arms of this class."""


def require_simulated(profile: Profile) -> None:
    """Raise ``InputError`` if the profile has no simulated cell."""
    if profile.plant is None:
        raise InputError(f"profile {profile.name}: the trial needs a simulated cell, a section 'plant'")


def drawn_cell(profile: Profile, seed: int, *, mix: bool = False) -> Profile:
    """Return the profile of a simulated cell; ``seed`` draws its true geometry, plan and splits.

    ``mix`` adds hidden effects of the arms themselves, with curves drawn by ``seed``.
    """
    profile = _with_mix(profile, seed) if mix else profile
    assert profile.plant is not None
    return profile.model_copy(update={"seed": seed, "plant": profile.plant.model_copy(update={"seed": seed})})


def _with_mix(profile: Profile, seed: int) -> Profile:
    assert profile.plant is not None
    hidden = {}
    for place, (name, arm) in enumerate(profile.arms.items()):
        count = len(arm.type.joints)
        sag: dict[str, object] = {"stiffness": [_STIFFNESS[place % 2]] * count}
        if place % 2:
            hidden[name] = {"joint_compliance": sag, "backlash": {"play": [_PLAY] * count}}
        else:
            curves = {"joints": list(range(1, count)), "rms": [_CURVE] * (count - 1), "lowest": 2, "highest": 30}
            hidden[name] = {"joint_compliance": sag, "transmission_error": {"mode": "curve", "seed": seed, **curves}}
    plant = profile.plant.model_copy(update={"effects": hidden})
    return profile.model_copy(update={"name": f"{profile.name}, mix", "plant": plant})


def measured_stops(profile: Profile, stops: int, seed: int) -> dict[str, Readings]:
    """Simulate readings of all arms at a plan of their own; all but the last ones are for learning."""
    planned = profile.model_copy(
        update={
            "seed": seed,
            "plan": profile.plan.model_copy(update={"stops": stops}),
        }
    )
    readings = measured_plan(planned, plan_stops(planned), seed)
    words = ("identify",) * (stops - 1) + ("validate",)
    return {name: replace(arm, split=words) for name, arm in readings.items()}


def calibrated_alone(profile: Profile, readings: Mapping[str, Readings]) -> dict[str, ArmModel]:
    """Calibrate all arms and search them for effects; return their models."""
    models = {name: calibrate_arm(profile, name, its)[0].model for name, its in readings.items()}
    conditions = conditions_of_arms(models, readings)
    return {
        name: discover_arm(profile, name, model, readings[name], conditions=conditions[name]).model
        for name, model in models.items()
    }
