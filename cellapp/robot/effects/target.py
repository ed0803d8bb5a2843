"""The retroreflector on the flange: slip of its mount, and errors with the angle of incidence."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from cellapp.robot.effects.base_motion import OnsetEffect
from cellapp.robot.effects.context import Channel, EffectColumn, EffectContext, shift_column
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import DriverVariable, Law, LawForm
from cellapp.robot.effects.modulation import FreeDriver
from cellapp.robot.effects.time_functions import after_onset

_MOST_SLIP = 1e-2
"""Bound [m]: a target that slipped by a centimetre has fallen off."""
_MOST_TURN = 0.1
"""Bound [rad] of a probe's turn in its mount; from twice this a calibration refuses the orientations."""
_MOST_INCIDENCE = 5e-3
"""Bound [m]: ``1 - cos th`` is 0.13 at 30 degrees, so that this is 0.7 mm, some thirty times the error of a prism."""
RADIAL = LawForm("radial", "along the beam")
LATERAL = LawForm("lateral", "along and across the beam")


class TargetSlip(OnsetEffect):
    """The SMR's mount slips: the SMR moves in the flange by ``d`` [m] along its x, y, z after an onset; a probe, whose
    orientation was measured, also turns by ``w`` [rad] about them.

    Onsets between readings are searched, none of them with fewer than 8 readings before or after it. Size: 20 to 200 µm
    (estimate); 59 % visible, as it rotates with the wrist. Look-alikes: no close one; a step of the base where the
    wrist hardly rotates.
    """

    slug = "target_slip"
    of_reading = True
    title = "slip of the target in the flange"
    meaning = Meaning.of(
        """cause: The SMR or its mount slipped in the flange at one moment of the run.
        size (estimate): 20 to 200 µm
        check: Check the screws of the SMR's mount and that the SMR sits clean and fully in it.
        check: Look in the log for a collision of the tool at that time.
        settle: Revisit one of the first poses at two rolls of the wrist: a slipped target rotates with it."""
    )
    look_alikes = ("base_step",)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Three columns, six of a probe; after the onset where the time is unknown."""
        moved = context.frames[0][-1] * after_onset(context, law)[:, None, None]
        slips = [
            shift_column(f"slip_{letter}", "m", Channel.TOOL, context.moved(moved[:, :, k]), -_MOST_SLIP, _MOST_SLIP)
            for k, letter in enumerate("xyz")
        ]
        if context.turned is None and (names is None or "turn_x" not in names):
            return slips
        turns = [context.moved(None, moved[:, :, k]) for k in range(3)]
        return slips + [
            shift_column(f"turn_{letter}", "rad", Channel.TOOL, turn_M, -_MOST_TURN, _MOST_TURN)
            for letter, turn_M in zip("xyz", turns, strict=True)
        ]


class TargetIncidence(Effect):
    """The reading depends on the angle th between the SMR's axis and the direction back to the tracker.

    Laws
    ----
    radial
        ``dP = k (1 - cos th) u / rho``, k in m: glass or a vertex off the centre lengthen the path.
    lateral
        Also ``dP = l (n - (n.b) b)``, n the SMR's axis and b the unit vector along the beam, which is sin th across the
        beam in the plane of incidence, l in m: dihedral errors of the three mirrors.

    Size: 2 to 20 µm, more for glass prisms (makers' notes on both; the sizes are an estimate). 43 % visible, the rest
    is an SMR offset. Visible with the same point at several wrist rolls. Look-alikes: none close once wrists rotate.
    """

    slug = "target_incidence"
    of_reading = True
    title = "target's error with the angle of incidence"
    meaning = Meaning.of(
        """cause: The reading changes with the angle at which the beam meets the reflector: a vertex off the centre,
          mirrors that are not square, a glass prism.
        size (estimate): 2 to 20 µm, more for glass prisms
        check: Clean the reflector, look for a damaged mirror, or exchange the SMR and repeat 10 stops.
        check: Mount the reflector so that it faces the tracker in the middle of the work.
        settle: Measure one point at six rolls of the wrist, and with the SMR rotated by 90 degrees in its mount."""
    )
    look_alikes = ("tracker_distance_offset",)
    variables = frozenset({DriverVariable.INCIDENCE})
    forms = (RADIAL, LATERAL)
    free_drivers = (FreeDriver(Quantity.INCIDENCE),)

    def missing_data(self, context: EffectContext) -> str:
        """Needs the SMR viewing direction."""
        return "the SMR viewing direction is not known" if context.smr_normal is None else ""

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """One column or two; zero where the SMR viewing direction is unknown."""
        radial, lateral = np.zeros((len(context), 3)), np.zeros((len(context), 3))
        if context.smr_normal is not None:
            _, beam = context.beam
            normal = context.frames[0][-1] @ context.smr_normal
            along = np.einsum("na,na->n", normal, beam)
            radial, lateral = (1.0 + along)[:, None] * beam, normal - along[:, None] * beam
        shifts = {"incidence_radial": radial}
        if law.form == LATERAL:
            shifts["incidence_lateral"] = lateral
        return [
            shift_column(name, "m", Channel.TRACKER, context.moved(shift_M), -_MOST_INCIDENCE, _MOST_INCIDENCE)
            for name, shift_M in shifts.items()
        ]
