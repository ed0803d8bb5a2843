"""The retroreflector on the flange: it slips, and it is read a little differently when it looks aside."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.effects.effect import EffectColumn, EffectContext, Law, shift_column, unknown_law
from cellapp.effects.history import after_onset, no_onset, onset_laws


class TargetSlip:
    """The SMR's mount slips: the SMR moves in the flange by ``d`` [m] along its x, y, z after an onset.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. Size: 20 to 200 um
    (estimate); 59 % visible, as it turns with the wrist. Look-alikes: no close one; a step of the base where the wrist
    hardly turns.
    """

    slug = "target_slip"
    title = "slip of the target in the flange"
    look_alikes: tuple[str, ...] = ("base_step",)
    variables = frozenset({"time"})

    def untestable(self, context: EffectContext) -> str:
        """Needs times."""
        return no_onset(context)

    def laws(self, context: EffectContext) -> list[Law]:
        """One for each onset."""
        return onset_laws(context)

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Three columns; after the onset where the time is unknown."""
        if law.name != "onset":
            raise unknown_law(self.slug, law)
        moved = context.frames[0][-1] * after_onset(context, law)[:, None, None]
        return [
            shift_column(f"slip_{letter}", "m", "tool", moved[:, :, k], -1e-2, 1e-2) for k, letter in enumerate("xyz")
        ]


class TargetIncidence:
    """The reading depends on the angle th between the SMR's axis and the way back to the tracker.

    Laws
    ----
    radial
        ``dP = k (1 - cos th) u / rho``, k in m: glass or a vertex off the centre lengthen the way.
    lateral
        Also ``dP = l (n - (n.b) b)``, n the SMR's axis and b the unit vector along the beam, which is sin th across the
        beam in the plane of incidence, l in m: dihedral errors of the three mirrors.

    Size: 2 to 20 um, more for glass prisms (makers' notes on both; the sizes are an estimate). 43 % visible, the rest
    is an SMR offset. Visible with the same point at several wrist rolls. Look-alikes: none close once wrists turn.
    """

    slug = "target_incidence"
    title = "target's error with the angle of incidence"
    look_alikes: tuple[str, ...] = ("tracker_distance_offset",)
    variables = frozenset({"incidence"})

    def untestable(self, context: EffectContext) -> str:
        """Needs the way the SMR looks."""
        return "the way the SMR looks is not known" if context.smr_normal is None else ""

    def laws(self, context: EffectContext) -> list[Law]:
        """Along the beam; across it too."""
        return [Law("radial"), Law("lateral")]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """One column or two; zero where nobody knows how the SMR looks."""
        if law.name not in ("", "radial", "lateral"):
            raise unknown_law(self.slug, law)
        radial, lateral = np.zeros((len(context), 3)), np.zeros((len(context), 3))
        if context.smr_normal is not None:
            _, beam = context.beam
            normal = context.frames[0][-1] @ context.smr_normal
            along = np.einsum("na,na->n", normal, beam)
            radial, lateral = (1.0 + along)[:, None] * beam, normal - along[:, None] * beam
        columns = [shift_column("incidence_radial", "m", "tracker", radial, -1e-3, 1e-3)]
        if law.name == "lateral":
            columns.append(shift_column("incidence_lateral", "m", "tracker", lateral, -1e-3, 1e-3))
        return columns
