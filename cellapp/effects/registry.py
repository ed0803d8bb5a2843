"""All effects that are looked for, by slug, the plainest first: ties go to the first."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.effects.backlash import Backlash, FrictionWindup
from cellapp.effects.base import BaseDrift, BaseStep
from cellapp.effects.effect import Effect
from cellapp.effects.joint_axis_wobble import JointAxisWobble
from cellapp.effects.joint_compliance import JointCompliance, PayloadCompliance
from cellapp.effects.link_bending import LinkBending
from cellapp.effects.pedestal import PedestalCompliance, PedestalCoupling
from cellapp.effects.periodic import EncoderEccentricity, TransmissionError
from cellapp.effects.target import TargetIncidence, TargetSlip
from cellapp.effects.thermal import JointDrift, ThermalGrowth
from cellapp.effects.tracker import TrackerAngleError, TrackerDistanceOffset, TrackerScale
from cellapp.effects.unknown import Unknown
from cellapp.effects.unsettled_measurement import UnsettledMeasurement

_ALL: tuple[Effect, ...] = (
    JointCompliance(),
    PayloadCompliance(),
    EncoderEccentricity(),
    TransmissionError(),
    Backlash(),
    FrictionWindup(),
    UnsettledMeasurement(),
    JointAxisWobble(),
    ThermalGrowth(),
    JointDrift(),
    BaseDrift(),
    BaseStep(),
    TargetSlip(),
    PedestalCompliance(),
    PedestalCoupling(),
    LinkBending(),
    TrackerScale(),
    TrackerDistanceOffset(),
    TrackerAngleError(),
    TargetIncidence(),
    Unknown(),
)
EFFECTS: Mapping[str, Effect] = {effect.slug: effect for effect in _ALL}
