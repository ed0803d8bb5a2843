"""Links that bend and twist as beams."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, shift_column, unknown_law
from cellapp.kinematics.statics import STANDARD_GRAVITY
from cellapp.kinematics.transforms import Array

_LONG = 0.3
"""A link shorter than this share of the longest does not bend noticeably: deflections grow with the third power."""
_LAWS = (
    "bending",
    "bending_torsion",
    "bending_own_weight",
    "bending_torsion_own_weight",
    "bending_torsion_free_weight",
)


class LinkBending:
    """A long link is a beam clamped at the joint before it and loaded at its end by the weight F of all beyond it.

    With e from D-H origin i-1 to origin i, length L, M the moment of that weight about the end, perp the part square to
    e (Euler-Bernoulli, tip load and tip moment):

        turn  = (M_perp L + e x F L^2 / 2) / EI
        shift = (F_perp L^3 / 3 + M x e L^2 / 2) / EI
        twist = (M.e) e L / GJ

    Laws
    ----
    bending
        One flexibility 1/EI a link [1/(N m^2)].
    bending_torsion
        1/GJ as well.
    bending_own_weight, bending_torsion_own_weight
        The link's own weight loads it too, where its centre of mass projects on the beam.
    bending_torsion_free_weight
        Its own weight bends it as much as the data want, a block of its own: how the mass is spread along the beam is
        not known.

    Size: EI of 1e5 N m^2 (estimate) gives 0.2 to 0.4 mm on a UR10, 0.1 mm on a UR5. 54 % visible. Look-alikes: joint
    compliance explains 0.99 of what is visible, 0.96 with two payloads; readings of both encoders of a joint tell them
    apart, as the second shows compliance only.
    """

    slug = "link_bending"
    title = "bending of links"
    look_alikes: tuple[str, ...] = (
        "joint_compliance",
        "payload_compliance",
        "encoder_eccentricity",
        "pedestal_compliance",
    )
    variables = frozenset({"q", "torque", "payload"})

    def untestable(self, context: EffectContext) -> str:
        """Needs masses."""
        return "" if context.bodies.masses.any() or context.payload_kg.any() else "no masses"

    def laws(self, context: EffectContext) -> list[Law]:
        """Bending; torsion too; each with the link's own weight."""
        return [Law(name) for name in _LAWS]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One or two columns for each long link, a block a link."""
        if law.name not in ("", *_LAWS):
            raise unknown_law(self.slug, law)
        lengths = np.hypot(context.geometry.rows[:, 1], context.geometry.rows[:, 2])
        columns = []
        for i in range(1, context.joints + 1):
            names = f"flexibility{i}", f"torsion{i}", f"own_weight{i}"
            if lengths[i - 1] < _LONG * lengths.max() and (wanted is None or not {*names} & {*wanted}):
                continue
            link = _Link.of(context, i)
            force, moment = context.load_beyond(i)
            bent, twisted = link.bent(force, moment, np.ones(len(context))), link.twisted(moment)
            free = law.name.endswith("free_weight")
            if free:
                own_force, own_moment, share = link.own_weight(context, i)
                own = link.bent(own_force, own_moment, share)
                twisted = twisted + link.twisted(own_moment, share)
                block = f"+ link {i} own weight"
                columns.append(shift_column(f"own_weight{i}", "1/(N m^2)", f"link {i}", own, 0.0, 1e-3, block))
            if law.name.endswith("own_weight"):
                own_force, own_moment, share = link.own_weight(context, i)
                bent, twisted = (
                    bent + link.bent(own_force, own_moment, share),
                    twisted + link.twisted(own_moment, share),
                )
            columns.append(shift_column(names[0], "1/(N m^2)", f"link {i}", bent, 0.0, 1e-3))
            if "torsion" in law.name:
                columns.append(shift_column(names[1], "1/(N m^2)", f"link {i}", twisted, 0.0, 1e-3))
        return columns


@dataclass(frozen=True)
class _Link:
    """A beam at n configurations: direction (n, 3), length (n,) [m], and from its end to the SMR (n, 3) [m]."""

    along: Array
    length: Array
    to_smr: Array

    @classmethod
    def of(cls, context: EffectContext, i: int) -> _Link:
        """From D-H origin i - 1 to origin i."""
        _, origins = context.frames
        along = origins[i] - origins[i - 1]
        length = np.linalg.norm(along, axis=1)
        return cls(along / np.maximum(length, 1e-9)[:, None], length, context.p_M - origins[i])

    def bent(self, force: Array, moment: Array, share: Array) -> Array:
        """Shift of the SMR (n, 3) for EI = 1, under a force and a moment (n, 3) at a share (n,) of the length.

        Beyond the load the beam is straight and leads on with the slope it has there.
        """
        e, L = self.along, (share * self.length)[:, None]
        lever = np.cross(e, force)
        moment_across = moment - np.einsum("na,na->n", moment, e)[:, None] * e
        turn = moment_across * L + lever * L**2 / 2.0
        shift = np.cross(lever, e) * L**3 / 3.0 + np.cross(moment, e) * L**2 / 2.0
        beyond = self.to_smr + e * (self.length[:, None] - L)
        return np.asarray(shift + np.cross(turn, beyond))

    def twisted(self, moment: Array, share: Array | float = 1.0) -> Array:
        """Shift of the SMR (n, 3) for GJ = 1, under a moment (n, 3) at a share of the length."""
        turn = np.einsum("na,na->n", moment, self.along) * share * self.length
        return np.cross(turn[:, None] * self.along, self.to_smr)

    def own_weight(self, context: EffectContext, i: int) -> tuple[Array, Array, Array]:
        """Weight of body i, its moment about the point of the beam that is nearest to it, and where that is (share)."""
        rotations, origins = context.frames
        center = origins[i] + rotations[i] @ context.bodies.centers[i - 1]
        from_joint = center - origins[i - 1]
        share = np.clip(np.einsum("na,na->n", from_joint, self.along) / np.maximum(self.length, 1e-9), 0.0, 1.0)
        force = np.tile(-STANDARD_GRAVITY * context.bodies.masses[i - 1] * context.up_M, (len(context), 1))
        aside = from_joint - (share * self.length)[:, None] * self.along
        return force, np.cross(aside, force), share
