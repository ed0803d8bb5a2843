"""Whose calibration a controller's rows are: that of an arm of the profile's type, or of another type."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from cellapp.cell.profile.messages import KeyPath, Spot
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import ArmType, Profile
from cellapp.robot.kinematics.chain import FACTORY_SOURCE, MOST_FACTORY, of_one_type
from cellapp.robot.kinematics.transforms import Array


def require_own_factories(
    profile: Profile, places: Mapping[KeyPath, Spot], types: Callable[[], Mapping[str, ArmType]]
) -> None:
    """Raise ``InputError`` if an arm's factory calibration is that of another type; ``types`` are those of cellapp."""
    for name, arm in profile.arms.items():
        if arm.factory is None:
            continue
        deltas, published = np.array(arm.factory.deltas).T, _published(arm.type)
        if of_one_type(published + deltas, published):
            continue
        where = places.get(("arms", name, "factory"), f"arms.{name}.factory")
        length, angle = (1e3 * most for most in MOST_FACTORY)
        raise InputError(
            f"{where}: not a calibration of a {arm.type.model}: its rows differ from the published ones by more than"
            f" {length:g} mm or {angle:g} mrad, {FACTORY_SOURCE}; it fits {fitting_types(deltas, 1.0, types())}."
            " Give the calibration.conf of this arm's controller ('cellapp doctor PROFILE --controllers FOLDER' writes"
            " it), or the arm's own type"
        )


def fitting_types(plain: Array, share: float, types: Mapping[str, ArmType]) -> str:
    """Name the types that rows (N, 4) are a calibration of: plain ones with ``share`` 0, with 1 the differences from
    the published ones."""
    alike = {stem: rows for stem, one in types.items() if (rows := _published(one)).shape == plain.shape}
    found = [stem for stem, rows in alike.items() if of_one_type(plain + share * rows, rows)]
    return " or ".join(found) or "no arm that comes with cellapp"


def _published(arm_type: ArmType) -> Array:
    return np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in arm_type.joints])
