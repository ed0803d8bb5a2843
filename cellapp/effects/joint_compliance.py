"""Torsional compliance of joints and gears under gravity, of the arm itself and of its payload."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from cellapp.effects.effect import PLAIN, EffectColumn, EffectContext, Law, joint_column, unknown_law, varies
from cellapp.kinematics.statics import STANDARD_GRAVITY
from cellapp.kinematics.transforms import Array

KNEES = (0.2, 0.35, 0.5, 0.65)
"""Where the stiffness may change, as shares of the largest torque of the run."""
_ROUNDING = 1e-6
"""A torque that never exceeds this [Nm] is one of rounding errors."""


class JointCompliance:
    """Each joint gives way to the gravity torque on it: ``dq_j = c_j tau_j(q, payload)``, c_j = 1 / K_j > 0 [rad/Nm].

    Laws
    ----
    linear
        One stiffness a joint.
    two_slope
        ``dq_j = c_j tau_j + s_j clip(tau_j, -T_j, T_j)``: softer below a knee torque T_j, as catalogues of strain-wave
        gears show (K1 < K2 < K3).
    In both, a share of the torque of the load, or of one body, may be added at a joint: the load was weighed, the arm's
    own masses were not.

    Size: strain-wave drives of this class have K = 1e4 to 1e5 Nm/rad (Harmonic Drive CSG catalogue, ratio 1:50,
    sourced); times the torques of a UR10, 1 to 3 mm at its flange (computed). Visible with a range of q2, q3; a payload
    change tells it from errors of the masses. Look-alikes: a bending link (nearly the same), one cycle a turn (0.8 of
    what is visible), tilting pedestal.
    """

    slug = "joint_compliance"
    title = "joint compliance under gravity"
    look_alikes: tuple[str, ...] = (
        "link_bending",
        "payload_compliance",
        "encoder_eccentricity",
        "pedestal_compliance",
    )
    variables = frozenset({"q", "torque", "payload"})

    def untestable(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if np.abs(context.torques).max(initial=0.0) > _ROUNDING else "gravity turns no joint (no masses)"

    def laws(self, context: EffectContext) -> list[Law]:
        """One stiffness; two with each knee."""
        largest = np.abs(context.torques).max(axis=0).tolist()
        knees = [
            Law("two_slope", {f"knee{j}": share * torque for j, torque in enumerate(largest, 1)}, tried=len(KNEES))
            for share in KNEES
        ]
        return [Law("linear"), *knees]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint, and what refines it: bodies, load, knee."""
        if law.name in ("", "linear", "two_slope"):
            columns = [
                replace(column, block=f"+ {column.name}", lower=-1e-4, upper=1e-4)
                for column in self._free_moments(context, wanted)
            ]
            loads = _load_torques(context)
            for j, stiff in enumerate(_of_torques("compliance", context.torques)):
                turned = _without_rounding(loads[:, j])
                load = joint_column(f"load{j + 1}", "rad/Nm", j, turned, -1e-4, 1e-4, f"+ load {j + 1}")
                columns += [stiff, load]
                if law.name != "two_slope":
                    continue
                assert stiff.offset is not None
                knee = law.constants.get(f"knee{j + 1}", 0.0)
                soft = np.clip(stiff.offset, -knee, knee)
                columns.append(joint_column(f"soft{j + 1}", "rad/Nm", j, soft, -1e-3, 1e-3, f"+ knee {j + 1}"))
            return columns
        raise unknown_law(self.slug, law)

    @staticmethod
    def _free_moments(context: EffectContext, wanted: Collection[str] | None) -> list[EffectColumn]:
        bodies, last = context.bodies, context.joints - 1
        rotations, origins = context.frames
        masses = np.tile(bodies.masses[:, None], (1, len(context)))
        moments = masses[:, :, None] * (origins[1:] + np.einsum("inab,ib->ina", rotations[1:], bodies.centers))
        moments[last] += context.payload_kg[:, None] * (origins[-1] + rotations[-1] @ bodies.payload_center)
        masses[last] += context.payload_kg
        columns = []
        for j in range(context.joints):
            turned = np.cross(-STANDARD_GRAVITY * context.up_M, rotations[j][:, :, 2])
            for i in range(j, context.joints):
                name = f"moment{j + 1}_{i + 1}"
                if (bodies.masses[i] == 0.0 and i != last) or (wanted is not None and name not in wanted):
                    continue
                torque = np.einsum("na,na->n", turned, moments[i] - masses[i][:, None] * origins[j])
                columns.append(joint_column(name, "rad/Nm", j, _without_rounding(torque), 0.0, 1e-3))
        return columns


class PayloadCompliance:
    """Each joint gives way to the torque of the payload alone: ``dq_j = c_j tau_j(q, payload)`` [rad/Nm].

    The deflection that comes and goes with the load in the gripper, of an arm whose own weight was calibrated away or
    is compensated by its controller. Size: 10 kg on a UR10 add 135 Nm at joint 2, 1.4 to 3.4 mm at the flange; 5 kg on
    a UR5 0.5 to 1.2 mm (computed from makers' tables and catalogue stiffness). Visible only where the payload varies;
    the same poses with two payloads tell it from all geometry. Look-alikes: joint compliance (the arm's own weight as
    well), a bending link.
    """

    slug = "payload_compliance"
    title = "joint compliance under the payload"
    look_alikes: tuple[str, ...] = ("joint_compliance", "link_bending")
    variables = frozenset({"q", "torque", "payload"})

    def untestable(self, context: EffectContext) -> str:
        """Needs a payload that varies."""
        known = context.known.payload_kg
        if known is None or not np.isfinite(known).all():
            return "no payloads"
        return "" if varies(known) else "payload does not vary"

    def laws(self, context: EffectContext) -> list[Law]:
        """One stiffness a joint."""
        return [PLAIN]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column a joint."""
        return _of_torques("payload_compliance", _load_torques(context))


def _of_torques(name: str, torques: Array) -> list[EffectColumn]:
    """One compliance a joint for torques (n, N) [Nm]."""
    return [
        joint_column(f"{name}{j + 1}", "rad/Nm", j, _without_rounding(torques[:, j]), 0.0, 1e-3)
        for j in range(torques.shape[1])
    ]


def _without_rounding(torque: Array) -> Array:
    """The torque, or plain zero where it never is one: a column of rounding errors would be as visible as any other."""
    return torque if np.abs(torque).max(initial=0.0) > _ROUNDING else np.zeros_like(torque)


def _load_torques(context: EffectContext) -> Array:
    """Torque of the load alone about each joint (n, N) [Nm]."""
    rotations, origins = context.frames
    load = origins[-1] + rotations[-1] @ context.bodies.payload_center
    turned = np.cross(-STANDARD_GRAVITY * context.up_M, rotations[:-1, :, :, 2])
    return np.asarray(np.einsum("jna,jna->nj", turned, load - origins[:-1]) * context.payload_kg[:, None])
