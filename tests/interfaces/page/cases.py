"""Typed results for corner cases that a small run does not produce; the result classes validate them."""

from __future__ import annotations

import math

from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult, PairMethodResult, Scatter
from cellapp.estimation.discovery.records import (
    AbsentEffect,
    AcceptedEffect,
    ArmDiscoveryResult,
    BeforeAfter,
    CurveRecord,
    CycleBand,
    DiscoverResult,
    Evidence,
    GapStep,
    LawRecord,
    Noise,
    Picture,
    Place,
    PredictedUncertainty,
    RemainingStructure,
    RunnerUp,
    SmallestSize,
    StructureTest,
    TermDescription,
)
from cellapp.ground.results import ErrorSummary, Estimate, Provenance, StageErrors
from cellapp.robot.effects.effect import Meaning

ANGLES = tuple(-170.0 + 2.0 * k for k in range(150))
"""Up to 128 deg: 62 deg of the turn have no reading."""
EVIDENCE = Evidence(statistic=250.25, corrected_p=0.004975, heldout_mm=BeforeAfter(before=0.4512, after=0.0312))
ERRORS = ErrorSummary(mean=0.1234, rms=0.2, std=0.05, max=0.4, n=17)


def picture(effect: str, joint: int, *, curve: bool = False) -> Picture:
    """Eleven cycles per turn; a curve is uncertain where it has no readings."""
    computed = [300.0 * math.sin(math.radians(11.0 * angle)) for angle in ANGLES]
    around = [-180.0 + k for k in range(361)]
    return Picture(
        title=f"{effect.replace('_', ' ')}, joint {joint}",
        effect=effect,
        x_label=f"joint {joint} [deg]" if curve else f"gravity torque on joint {joint} [Nm]",
        y_label=f"offset of joint {joint} [urad]",
        x=ANGLES,
        measured=tuple(value + 20.0 * (-1) ** k for k, value in enumerate(computed)),
        computed=tuple(computed),
        band=(5.0,) * len(ANGLES),
        curve=CurveRecord(
            x=tuple(around),
            value=tuple(300.0 * math.sin(math.radians(11.0 * angle)) for angle in around),
            band=tuple(10.0 if angle < 128.0 else 150.0 for angle in around),
        )
        if curve
        else None,
    )


def _joints(*joints: int) -> Place:
    return Place(joints=joints, acts_on=tuple(f"joint {joint}" for joint in joints))


def free_curve() -> AcceptedEffect:
    """A periodic error of two joints with too many coefficients for a table."""
    return AcceptedEffect(
        effect="transmission_error",
        title="transmission error",
        law=LawRecord(name="curve", constants={}),
        where=_joints(1, 2),
        parameters={f"cos{k}q1": Estimate(value=1e-5, standard_error=1e-6, unit="rad") for k in range(2, 60)},
        evidence=EVIDENCE,
        runners_up=(),
        cycles={
            "1": CycleBand(first=9, last=37, peak=11, rms_urad=212.4),
            "2": CycleBand(first=14, last=14, peak=14, rms_urad=80.0),
        },
    )


def ambiguous_compliance() -> AcceptedEffect:
    """A compliance with a knee that two alternatives explain as well."""
    return AcceptedEffect(
        effect="joint_compliance",
        title="joint compliance",
        law=LawRecord(name="two_slope", constants={"knee2": 18.84}),
        where=_joints(2, 3, 4, 6),
        parameters={"compliance2": Estimate(value=1.6668e-5, standard_error=1.8e-8, unit="rad/Nm")},
        evidence=EVIDENCE,
        runners_up=(
            RunnerUp(effect="pedestal_compliance", statistic=249.0, distinguishable=False),
            RunnerUp(effect="link_bending", statistic=248.0, distinguishable=False),
            RunnerUp(effect="tracker_angle_error", statistic=244.0, distinguishable=True),
        ),
        posterior=0.874,
        law_misfit=0.183,
        meaning=Meaning(
            cause="The gears of joints 2, 3, 4 and 6 twist.",
            size="1 to 3 mm",
            size_source="computed",
            check=("Check the bolts of the gearbox of joint 2, which takes more than one line of a terminal to say.",),
            settle=("Repeat 20 stops with a second payload.", "Log both encoders."),
        ),
    )


def data_driven_term(formula: str = "c |sin(q2)|") -> AcceptedEffect:
    """A term without a name."""
    return AcceptedEffect(
        effect="unknown",
        title="unknown",
        law=LawRecord(name="joint 5|q2", constants={}),
        where=Place(joints=(5,), acts_on=("joint 5",), channel="joint 5", variables=("q2",)),
        parameters={"joint_5.cos1_q2": Estimate(value=1e-4, standard_error=1e-6, unit="rad")},
        evidence=EVIDENCE,
        runners_up=(),
        description=TermDescription(
            channel="joint 5",
            variables=("q2",),
            size_um=22.4,
            formula=formula,
            sentence="joint 5 depends on q2, about c |sin(q2)|; 22 µm rms at the SMR",
        ),
    )


def unknown_effect(name: str) -> ArmDiscoveryResult:
    """An arm with a free curve, an effect with alternatives and a data-driven term."""
    return ArmDiscoveryResult(
        noise_floor_mm=0.0223,
        heldout_mm=BeforeAfter(before=0.4906, after=0.0312),
        steps=(
            GapStep(what="geometry alone", effect="", heldout_mm=0.4906),
            GapStep(what="transmission error: a free curve a joint", effect="transmission_error", heldout_mm=0.1112),
            GapStep(what="a data-driven term added", effect="unknown", heldout_mm=0.0299),
        ),
        threshold=9.7,
        omnibus_p=0.0,
        scatter=1.4,
        accepted=(free_curve(), ambiguous_compliance(), data_driven_term()),
        noise_mm=Noise(rms=0.0223, source="stated"),
        candidates={"joint_compliance": 0.874, "link_bending": 0.126, "backlash": 0.003, "transmission_error": 1.0},
        structure=RemainingStructure(
            tests=(StructureTest(against="joints", p_value=0.41), StructureTest(against="time", p_value=0.0005)),
            sentence="the residuals still depend on time (p below 0.001)",
        ),
        invisible=(
            AbsentEffect(effect="backlash", reason="not testable: no approach signs"),
            AbsentEffect(
                effect="tracker_scale",
                reason="invisible: geometry follows nearly all of it under this plan",
                visible_share=0.01,
                smallest_seen_rms_mm=0.3988,
            ),
        ),
        not_found=(
            AbsentEffect(
                effect="target_slip",
                reason="not found; it could have been seen from these sizes on",
                visible_share=0.97,
                smallest_seen={"slip_x": SmallestSize(value=3e-5, unit="m")},
                smallest_seen_rms_mm=0.0047,
            ),
        ),
        uncertainty_mm=PredictedUncertainty(median=0.0937, largest=0.374),
        pictures=(
            picture("transmission_error", 1, curve=True),
            picture("transmission_error", 2, curve=True),
            picture("joint_compliance", 2),
            picture("joint_compliance", 3),
            picture("joint_compliance", 4),
            picture("unknown", 5),
        ),
        validate_={"effects": StageErrors(position_mm=ERRORS)},
        verdict="unknown effect",
        sentence=f"arm {name}: something that the library does not have; 31 µm rms held out",
    )


def nothing_missing(name: str) -> ArmDiscoveryResult:
    """An arm in whose data nothing was found."""
    return ArmDiscoveryResult(
        noise_floor_mm=0.0223,
        heldout_mm=BeforeAfter(before=0.0225, after=0.0225),
        steps=(GapStep(what="geometry alone", effect="", heldout_mm=0.0225),),
        threshold=9.7,
        omnibus_p=0.42,
        scatter=1.01,
        accepted=(),
        invisible=unknown_effect(name).invisible,
        not_found=unknown_effect(name).not_found,
        verdict="nothing missing",
        sentence=f"arm {name}: 23 µm rms held out against a noise floor of 22 µm",
    )


def discovery(first: str, second: str) -> DiscoverResult:
    """Two arms: one with everything, one with nothing."""
    return DiscoverResult(arms={first: unknown_effect(first), second: nothing_missing(second)})


def calibration(*arms: str) -> CalibrateResult:
    """Arms of which only the nominal stage was evaluated."""
    arm = ArmCalibrationResult(
        identified={},
        rank=27,
        parameter_set="auto",
        merged={},
        iterations=4,
        condition=None,
        scatter=Scatter(value=1.0, meaning=""),
        degrees_of_freedom=100,
        splits={"validate": 17},
        validate_={"nominal": StageErrors(position_mm=ERRORS)},
    )
    return CalibrateResult(
        arms=dict.fromkeys(arms, arm),
        pair={"nominal": PairMethodResult(cooperative_mm=ERRORS)},
        notes=(),
        provenance=Provenance(profile="twin", seed=1, program="cellapp", written="2026-01-02T12:00:00+00:00"),
    )
