"""Links that bend and twist as beams."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cellapp.robot.effects.context import ActsOn, EffectColumn, EffectContext, shift_column
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, ImpossibleValues, Meaning
from cellapp.robot.effects.law import InputVariable, Law, LawForm
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.kinematics.transforms import Array

_LONG = 0.3
"""A link shorter than this fraction of the longest does not bend noticeably: deflection grows with the third power."""
_UNIT = "1/(N m^2)"
_MOST_FLEXIBILITY = 1e-3
"""Bound of 1/EI and 1/GJ: a hundred times the estimated one."""
_SHEAR_UNIT = "1/N"
_MOST_SHEAR = 1e-6
"""Bound of 1/(k G A): twenty times that of an aluminium tube of 20 cm^2."""
_SHORTEST = 1e-9
"""Length [m] below which a link has no direction."""

BENDING = LawForm("bending", "bending under what the link carries")
TORSION = LawForm("bending_torsion", "bending and torsion under what the link carries")
OWN_WEIGHT = LawForm("bending_own_weight", "bending, own weight included")
TORSION_OWN_WEIGHT = LawForm("bending_torsion_own_weight", "bending and torsion, own weight included")
FREE_WEIGHT = LawForm("bending_torsion_free_weight", "bending and torsion, own weight left free")


class LinkBending(Effect):
    """A long link is a beam clamped at the joint before it and loaded at its end by the weight F of all beyond it.

    With e from D-H origin i-1 to origin i, length L, M the moment of that weight about the end, perp the part
    perpendicular to e (Euler-Bernoulli, tip load and tip moment):

        turn  = (M_perp L + e x F L^2 / 2) / EI
        shift = (F_perp L^3 / 3 + M x e L^2 / 2) / EI
        twist = (M.e) e L / GJ

    Laws
    ----
    bending
        One flexibility 1/EI per link [1/(N m^2)].
    bending_torsion
        1/GJ as well.
    bending_own_weight, bending_torsion_own_weight
        The link's own weight loads it too, where its centre of mass projects on the beam.
    bending_torsion_free_weight
        The bending by its own weight is a parameter and block of its own: how the mass is distributed along the beam is
        unknown.

    In all of them shear, ``shift = F_perp L / (k G A)`` [1/N] (Timoshenko), may refine the bending of a link: short
    wide tubes with openings show it.

    Size: EI of 1e5 N m^2 (estimate) gives 0.2 to 0.4 mm on a UR10, 0.1 mm on a UR5. 54 % visible. Confounded: joint
    compliance explains 0.99 of what is visible, 0.96 with two payloads; readings of both encoders of a joint
    distinguish them, as the second shows compliance only.
    """

    slug = "link_bending"
    title = "bending of links"
    arm_bound = True
    meaning = Meaning.of(
        """cause: {place} bends and twists as a beam under all that it carries; a cracked clamp or a loose bolt at its
          end adds to it.
        size (estimate): 0.2 to 0.4 mm at the flange of a UR10, 0.1 mm of a UR5, for a bending stiffness of 1e5 N m^2
        check: Check the bolts at both ends of {place}.
        settle: Measure two or three SMRs on {place}, stretched and folded.
        settle: Log motor-side and output-side encoders: bending does not show there.
        settle: Repeat 20 stops near zero and near the rated load."""
    )
    confounded = ("joint_compliance", "payload_compliance", "encoder_eccentricity", "pedestal_compliance")
    impossible = ImpossibleValues(
        sign="a link that bends upwards under its load",
        sign_check="check masses, direction of gravity and mounting",
        size_check="check masses, direction of gravity and mounting",
    )
    variables = frozenset({InputVariable.JOINT_ANGLE, InputVariable.TORQUE, InputVariable.PAYLOAD})
    forms = (BENDING, TORSION, OWN_WEIGHT, TORSION_OWN_WEIGHT, FREE_WEIGHT)
    discrepancy_inputs = (TermInput(Quantity.TORQUE), TermInput(Quantity.JOINT_ANGLE), TermInput(Quantity.PAYLOAD))

    def missing_data(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if context.bodies.masses.any() or context.payload_kg.any() else "no masses"

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One to three columns for each long link, a block per link."""
        longest = context.link_lengths.max()
        columns = []
        for i in range(context.joints):
            own = {f"{name}{i + 1}" for name in ("flexibility", "torsion", "own_weight", "shear")}
            if context.link_lengths[i] >= _LONG * longest or own & {*(names or ())}:
                columns += _link_columns(context, law.form, i)
        return columns


def _link_columns(context: EffectContext, form: LawForm, i: int) -> list[EffectColumn]:
    """Columns of link ``i`` (from 0)."""
    beam = _Beam.of(context, i)
    force, moment = context.loads.beyond(i + 1)
    bent, twisted = beam.bent(force, moment, np.ones(len(context))), beam.twisted(moment)

    def column(name: str, shift_M: Array, part: str = "", unit: str = _UNIT, most: float = _MOST_FLEXIBILITY) -> None:
        block, refines = f"link {i + 1}{part}", bool(part)
        made = shift_column(f"{name}{i + 1}", unit, ActsOn.LINK, shift_M, 0.0, most, block, index=i, refines=refines)
        columns.append(made)

    columns: list[EffectColumn] = []
    if form in (OWN_WEIGHT, TORSION_OWN_WEIGHT, FREE_WEIGHT):
        own_force, own_moment, fraction = beam.own_weight(i)
        bent_by_own = beam.bent(own_force, own_moment, fraction)
        twisted = twisted + beam.twisted(own_moment, fraction)
        if form == FREE_WEIGHT:
            column("own_weight", bent_by_own, " own weight")
        else:
            bent = bent + bent_by_own
    column("flexibility", bent)
    column("shear", beam.sheared(force), " shear", _SHEAR_UNIT, _MOST_SHEAR)
    if form in (TORSION, TORSION_OWN_WEIGHT, FREE_WEIGHT):
        column("torsion", twisted)
    return columns


@dataclass(frozen=True)
class _Beam:
    """A link at n configurations: direction (n, 3), length (n,) [m], and vector from its end to the SMR (n, 3) [m]."""

    context: EffectContext
    along: Array
    length: Array
    to_smr: Array

    @classmethod
    def of(cls, context: EffectContext, i: int) -> _Beam:
        """From D-H origin ``i`` to origin ``i + 1``."""
        _, origins = context.frames
        along = origins[i + 1] - origins[i]
        length = np.linalg.norm(along, axis=1)
        return cls(context, along / np.maximum(length, _SHORTEST)[:, None], length, context.p_M - origins[i + 1])

    def bent(self, force: Array, moment: Array, fraction: Array) -> Array:
        """SMR shift (n, 3) for EI = 1, under a force and a moment (n, 3) at a fraction (n,) of the length.

        Beyond the load the beam is straight and continues with the slope it has there.
        """
        e, L = self.along, (fraction * self.length)[:, None]
        lever = np.cross(e, force)
        moment_across = moment - np.einsum("na,na->n", moment, e)[:, None] * e
        rotation = moment_across * L + lever * L**2 / 2.0
        shift = np.cross(lever, e) * L**3 / 3.0 + np.cross(moment, e) * L**2 / 2.0
        beyond = self.to_smr + e * (self.length[:, None] - L)
        return self.context.moved(shift, rotation, beyond)

    def twisted(self, moment: Array, fraction: Array | float = 1.0) -> Array:
        """SMR shift (n, 3) for GJ = 1, under a moment (n, 3) at a fraction of the length."""
        rotation = np.einsum("na,na->n", moment, self.along) * fraction * self.length
        return self.context.moved(None, rotation[:, None] * self.along, self.to_smr)

    def sheared(self, force: Array) -> Array:
        """SMR shift (n, 3) for k G A = 1, under a force (n, 3) at the end."""
        across = force - np.einsum("na,na->n", force, self.along)[:, None] * self.along
        return self.context.moved(across * self.length[:, None])

    def own_weight(self, i: int) -> tuple[Array, Array, Array]:
        """Weight of body ``i``, its moment about the nearest point of the beam, and where that is (fraction)."""
        loads = self.context.loads
        from_joint = loads.centers[i] - loads.origins[i]
        along = np.einsum("na,na->n", from_joint, self.along)
        fraction = np.clip(along / np.maximum(self.length, _SHORTEST), 0.0, 1.0)
        force = loads.masses[i][:, None] * loads.gravity
        aside = from_joint - (fraction * self.length)[:, None] * self.along
        return force, np.cross(aside, force), fraction
