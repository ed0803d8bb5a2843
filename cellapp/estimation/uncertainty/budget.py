"""Uncertainty budget of a measured position error, by JCGM 100:2008 (GUM). Pure functions, no I/O.

The measured error is the distance of the measured SMR from its commanded position. Each contribution is the standard
uncertainty of a coordinate in its worst direction; the error is a length, whose sensitivity to a shift is at most 1
(GUM 5.1.3). The contributions are independent, so their variances add (GUM 5.1.2, equation 10). The expanded
uncertainty is twice the combined one (GUM 6.2.1, k = 2).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.records import ArmCalibrationResult
from cellapp.estimation.discovery.records import ArmDiscoveryResult
from cellapp.estimation.readings.readings import Readings
from cellapp.estimation.uncertainty.records import (
    AngleContribution,
    Conformity,
    ToleranceVerdict,
    UncertaintyContribution,
    UncertaintyParts,
)
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import ArmType, PermissibleError
from cellapp.ground.profile.sections import MPE_SHARE, MpeRule
from cellapp.ground.results import DecisionRule
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.thermal import ALUMINIUM
from cellapp.robot.kinematics.transforms import Array

COVERAGE = 2.0
"""Coverage factor k; about 95 % for a normal distribution (GUM 6.2.1, G.6.6)."""
AIR_PER_KELVIN = 1e-6
"""Change of a measured range with the air temperature [1/K]: the refractive index of air falls by 0.93e-6 per kelvin at
20 degC, 1013 hPa (Ciddor, Applied Optics 35 (1996) 1566)."""

MPE_WORDS: Mapping[MpeRule, str] = {
    "rectangular": "divided by the square root of 3 (rectangular: any error up to it is as likely)",
    "half": "divided by 2 (tolerances.mpe: half was chosen)",
}
"""Explanation of how the standard uncertainty follows from a maximum permissible error."""

TRACKER, CENTERING, AIR = "tracker", "SMR centering", "air temperature"
REPEATABILITY, MODEL, STATION, GROWTH = "arm repeatability", "calibrated model", "station", "thermal growth of the arm"


@dataclass(frozen=True)
class BudgetEvidence:
    """Data of a run on the errors of one arm, beside its profile. Only ``calibrated`` may be out of date.

    Attributes
    ----------
    calibrated, discovered : results, optional
        Results of the calibration and of the discovery.
    commands : tuple
        Uncertainties of the compensated commands.
    verified_m : float, optional
        Largest distance of a verified target from the tracker [m].
    station_mm : float, optional
        Uncertainty of the station, if the tracker was moved and located [mm].
    measured : MeasuredConditions, optional
        Conditions of the readings. The thermal growth of the arm is stated only if they have temperatures; their
        distances are used if no target was verified.
    """

    calibrated: ArmCalibrationResult | None = None
    discovered: ArmDiscoveryResult | None = None
    commands: tuple[UncertaintyParts, ...] = ()
    verified_m: float | None = None
    station_mm: float | None = None
    measured: MeasuredConditions | None = None

    @property
    def farthest_m(self) -> float | None:
        """Largest distance of the SMR from the tracker at the verified targets, else of the readings [m]."""
        if self.verified_m is not None:
            return self.verified_m
        return None if self.measured is None or self.measured.distance_m is None else self.measured.distance_m[1]


def position_budget(
    profile: Profile,
    arm: str,
    known: BudgetEvidence,
    distance_m: float | None = None,
    parts: UncertaintyParts | None = None,
) -> tuple[UncertaintyContribution, ...]:
    """Return the contributions to the uncertainty of a position error of ``arm``; unstated ones have no value.

    They are those at one place, ``distance_m`` from the tracker, else at the farthest; ``parts`` are those of a command
    there.
    """
    distance_m = known.farthest_m if distance_m is None else distance_m
    model = _model(known)
    if parts is not None:
        model = _line(MODEL, _of_model_mm(parts), "A", "posterior of the model in force at the command")
    growth = _growth(profile.arms[arm].type, known.discovered, known.measured)
    moved = "the tracker was moved and located by a few points"
    return (
        _tracker(profile, distance_m),
        _centering(profile),
        _air(profile, distance_m),
        _repeatability(known),
        model,
        *([] if known.station_mm is None else [_line(STATION, known.station_mm, "A", moved)]),
        *([] if growth is None else [growth]),
    )


def distance_budget(position: Sequence[UncertaintyContribution]) -> tuple[UncertaintyContribution, ...]:
    """Return the contributions to the error of the distance between two positions of one arm, from those of a position.

    Both positions count as if independent: an upper bound, as common errors cancel. The station does not matter: a
    motion of the whole frame changes no distance.
    """
    return tuple(
        one if one.standard_mm is None else one.model_copy(update={"standard_mm": math.sqrt(2.0) * one.standard_mm})
        for one in position
        if one.source != STATION
    )


def combined(standard: Iterable[float | None]) -> float | None:
    """Combine standard uncertainties, in any unit; None if one is missing, as the result would be too small."""
    values = list(standard)
    known = [value for value in values if value is not None]
    return math.hypot(*known) if known and len(known) == len(values) else None


def combined_mm(contributions: Iterable[UncertaintyContribution]) -> float | None:
    """Return the combined standard uncertainty [mm]; None as in ``combined``."""
    return combined(one.standard_mm for one in contributions)


def expanded_mm(contributions: Iterable[UncertaintyContribution]) -> float | None:
    """Return the expanded uncertainty [mm], k = 2; None as in ``combined``."""
    standard_mm = combined_mm(contributions)
    return None if standard_mm is None else COVERAGE * standard_mm


def not_given(contributions: Iterable[UncertaintyContribution]) -> list[str]:
    """Return the names of the contributions without a value."""
    return list(dict.fromkeys(one.source for one in contributions if one.standard_mm is None))


def permissible_mm(error: PermissibleError, distance_m: float) -> float:
    """Return a maximum permissible error at a distance [mm]."""
    return (error.constant + error.proportional * distance_m) * 1e3


# -- contributions ----------------------------------------------------------------------------------------------------


def _tracker(profile: Profile, farthest_m: float | None) -> UncertaintyContribution:
    tracker = profile.tracker
    if tracker is None or farthest_m is None:
        return _line(TRACKER, None, "B", "not given: the profile states no tracker, or no distance was measured")
    across, along = (permissible_mm(error, farthest_m) for error in (tracker.transverse, tracker.range))
    rule = profile.tolerances.mpe
    basis = (
        f"stated maximum permissible error at {farthest_m:.2f} m: {across:.4f} mm across the beam, {along:.4f} mm along"
        f" it; the larger counts, {MPE_WORDS[rule]}"
    )
    return _line(TRACKER, max(across, along) * MPE_SHARE[rule], "B", basis)


def _centering(profile: Profile) -> UncertaintyContribution:
    stated = profile.traceability.smr_centering
    if stated is None:
        return _line(CENTERING, None, "B", "not given (traceability.smr_centering)")
    return _line(CENTERING, stated * 1e3, "B", "stated standard uncertainty of the optical centre (traceability)")


def _air(profile: Profile, farthest_m: float | None) -> UncertaintyContribution:
    kelvin = profile.traceability.air_temperature_uncertainty
    if kelvin is None or farthest_m is None:
        return _line(AIR, None, "B", "not given (traceability.air_temperature_uncertainty)")
    basis = f"stated {kelvin:g} K along the beam, {AIR_PER_KELVIN * 1e6:g} µm/m per kelvin, at {farthest_m:.2f} m"
    return _line(AIR, AIR_PER_KELVIN * kelvin * farthest_m * 1e3, "B", basis)


def _repeatability(known: BudgetEvidence) -> UncertaintyContribution:
    """Return the scatter of readings beyond the tracker's stated one: about the model with effects, else of repeats.

    The model with effects takes precedence: repeats of an arm with backlash scatter by the side of approach, which a
    compensated command accounts for.
    """
    found = known.discovered
    if found is not None and found.scatter is not None and found.noise_mm is not None:
        tracker = found.noise_mm.rms / math.sqrt(3.0)
        excess = tracker * math.sqrt(max(found.scatter**2 - 1.0, 0.0))
        basis = (
            f"scatter of the readings about the model is {found.scatter:.2f} times the {found.noise_mm.source} noise of"
            f" {tracker:.4f} mm a coordinate; what exceeds it"
        )
        return _line(REPEATABILITY, excess, "A", basis)
    calibrated = known.calibrated
    repeats = None if calibrated is None else calibrated.repeatability_mm
    if calibrated is None or repeats is None:
        return _line(REPEATABILITY, None, "A", "not given: no stop was repeated and no discovery holds")
    scatter = repeats.coordinate
    tracker = (calibrated.tracker_mm or 0.0) / math.sqrt(3.0)
    basis = (
        f"{repeats.n} repeated stops scatter by {scatter:.4f} mm a coordinate; what exceeds the tracker's"
        f" {tracker:.4f} mm"
    )
    return _line(REPEATABILITY, math.sqrt(max(scatter**2 - tracker**2, 0.0)), "A", basis)


def _model(known: BudgetEvidence) -> UncertaintyContribution:
    """Return the uncertainty of the target in the tracker frame: the model's posterior at the commands."""
    if known.commands:
        return _line(
            MODEL,
            max(map(_of_model_mm, known.commands)),
            "A",
            f"posterior of the model in force, largest of {counted(len(known.commands), 'command')}",
        )
    found = known.discovered
    if found is not None and found.uncertainty_mm is not None:
        return _line(MODEL, found.uncertainty_mm.largest, "A", "posterior of the model, largest at held-out stops")
    return _line(MODEL, None, "A", "not given: no posterior of the model in force is stored")


def _growth(
    arm_type: ArmType, found: ArmDiscoveryResult | None, measured: MeasuredConditions | None
) -> UncertaintyContribution | None:
    """Return the growth of the arm over the measured temperatures; None if there are none.

    If there is a valid discovery, readings at all these temperatures were compared with the model: growth that it lacks
    is part of their scatter, which counts as repeatability.
    """
    spans = [] if measured is None else [span for span in (measured.air_c, measured.joints_c) if span is not None]
    if not spans:
        return None
    half = max(high - low for low, high in spans) / 2.0
    if found is not None and found.scatter is not None:
        grows = any(one.effect in EFFECTS and EFFECTS[one.effect].lengthens for one in found.accepted)
        how = "the model corrects it" if grows else "none was found"
        basis = f"{how} over the {2.0 * half:.1f} K that were measured; the residual is part of the arm's scatter above"
        return _line(GROWTH, 0.0, "A", basis)
    reach = sum(abs(joint.a) + abs(joint.d) for joint in arm_type.joints)
    basis = (
        f"temperatures within {half:.1f} K of their middle, rectangular; aluminium ({ALUMINIUM * 1e6:g} µm/m per"
        f" kelvin) over {reach:.2f} m of links"
    )
    return _line(GROWTH, ALUMINIUM * reach * half / math.sqrt(3.0) * 1e3, "B", basis)


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_model_mm(parts: UncertaintyParts) -> float:
    """Return the standard uncertainty [mm] of a coordinate by the model alone."""
    return math.hypot(parts.parameters, parts.effects, parts.network, parts.extrapolation)


def _line(source: str, standard_mm: float | None, evaluation: str, basis: str) -> UncertaintyContribution:
    return UncertaintyContribution.model_validate(
        {"source": source, "standard_mm": standard_mm, "evaluation": evaluation, "basis": basis}
    )


# -- Uncertainty budget of a measured orientation error (JCGM 100): independent contributions, for one component ------


def angle_budget(
    profile: Profile, arm: str, model_mrad: float, noise_mrad: float, basis: str = "at the command"
) -> tuple[AngleContribution, ...]:
    """Return the contributions to the uncertainty of a flange rotation measured by a probe or several SMRs [mrad].

    With several SMRs only the scatter about the model is known, which includes the arm's repeatability.

    Parameters
    ----------
    model_mrad : float
        Standard uncertainty of a component by the model in force, including the mounting of the probe.
    noise_mrad : float
        Scatter of measured orientations about the model.
    basis : str
        Words that say to which command ``model_mrad`` belongs.
    """
    smr, scatter = profile.arms[arm].smr, f"orientations scatter by {noise_mrad:.4f} mrad about the model"
    stated = None if smr.probe is None else smr.probe.sigma * 1e3
    beyond = math.sqrt(max(noise_mrad**2 - (stated or 0.0) ** 2, 0.0))
    said = "not given: the profile states no probe (smr.probe)"
    lines = [
        ("6-D probe", stated, "B", said if stated is None else "stated standard uncertainty about each axis"),
        ("repeatability of the arm", beyond, "A", f"{scatter}; what exceeds the probe's"),
        ("calibrated model", model_mrad, "A", f"posterior of the model in force {basis}"),
    ]
    return tuple(
        AngleContribution.model_validate(
            {"source": source, "standard_mrad": value, "evaluation": kind, "basis": words, "where": arm}
        )
        for source, value, kind, words in lines
    )


def expanded_mrad(contributions: Sequence[AngleContribution]) -> float | None:
    """Return the expanded uncertainty [mrad], k = 2; None if a contribution is missing."""
    standard_mrad = combined(one.standard_mrad for one in contributions)
    return None if standard_mrad is None else COVERAGE * standard_mrad


# -- Conditions of an arm's measurements: distances from the tracker, temperatures, payload. No I/O -------------------

Range = tuple[float, float]


@dataclass(frozen=True)
class MeasuredConditions:
    """Smallest and largest values over the readings of one arm; None if no reading has the quantity.

    ``distance_m`` is from the tracker to the SMR, ``air_c`` the air or arm temperature of the readings, ``joints_c``
    that of the joints [degC], ``payload_kg`` the payload.
    """

    readings: int
    distance_m: Range | None = None
    air_c: Range | None = None
    joints_c: Range | None = None
    payload_kg: Range | None = None


def measured_conditions(readings: Mapping[str, Readings]) -> dict[str, MeasuredConditions]:
    """Return the conditions of the readings of each arm."""
    return {
        name: MeasuredConditions(
            readings=len(its),
            distance_m=range_of(np.linalg.norm(its.p_M, axis=1)),
            air_c=range_of(its.temperature_c),
            joints_c=range_of(its.joint_temperature_c),
            payload_kg=range_of(its.payload_kg),
        )
        for name, its in readings.items()
    }


def range_of(values: NDArray[np.float64] | None) -> Range | None:
    """Return the smallest and the largest of the known values; None if none is known."""
    known = np.empty(0) if values is None else values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else None


# -- The single decision rule: whether an error conforms to its tolerance, given its uncertainty ----------------------
#
# Certificate, verification of targets, paths, tests by ISO 9283, predictions and the terminal application all use it.

TARGET_WORDS: Mapping[Conformity, ToleranceVerdict] = {
    "conforms": "in",
    "does not conform": "out",
    "not decided": "not decided",
}
"""The decision in the words of targets and paths."""


def conformity(value: float | None, expanded: float | None, tolerance: float, rule: DecisionRule) -> Conformity:
    """Decide on an error against an upper limit; all in one unit.

    ``guarded`` is ISO 14253-1: conformity is proven if ``value + expanded <= tolerance``, nonconformity if ``value -
    expanded > tolerance``, and neither between; without an expanded uncertainty there is no decision. ``simple``
    compares the value alone (ISO/IEC Guide 98-4, simple acceptance). A missing value gives no decision.
    """
    if value is None:
        return "not decided"
    if rule == "simple":
        return decided(value, value, tolerance)
    return "not decided" if expanded is None else decided(value - expanded, value + expanded, tolerance)


def decided(low: float, high: float, tolerance: float) -> Conformity:
    """Decide for an error between two bounds: proven inside, proven outside, or neither."""
    if high <= tolerance:
        return "conforms"
    return "does not conform" if low > tolerance else "not decided"


# ---------------------------------------------------------------------------------------------------------------------
# Judgement of measured targets and paths against their tolerances, by the single rule and with the same uncertainty.
#
# The expanded uncertainty of a distance from a target is that of the certificate: its contributions at the measured
# place and for the command sent. If one is missing, the uncertainty is unknown and the rule decides nothing.


@dataclass(frozen=True)
class Judge:
    """Judge of errors in one cell.

    ``known`` holds the data of the run on the errors of each arm.
    """

    profile: Profile
    known: Mapping[str, BudgetEvidence] = field(default_factory=dict)

    @property
    def rule(self) -> DecisionRule:
        """Rule chosen in the profile."""
        return self.profile.tolerances.decision

    def expanded_mm(
        self, measured_M: Mapping[str, Array], parts: Mapping[str, UncertaintyParts | None]
    ) -> float | None:
        """Return the expanded uncertainty [mm] at measured SMRs, arm -> (3,) [m]; for two arms of their distance.

        None if a contribution is missing.
        """
        return expanded_mm(self._budget(measured_M, parts))

    def verdict(self, error_mm: float | None, expanded: float | None, tolerance_mm: float | None) -> ToleranceVerdict:
        """Return ``conformity`` in the words of targets; empty without a tolerance or an error."""
        if error_mm is None or tolerance_mm is None:
            return ""
        return TARGET_WORDS[conformity(error_mm, expanded, tolerance_mm, self.rule)]

    def not_given(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Return the missing contributions, without which the guarded rule decides nothing."""
        if self.rule != "guarded":
            return ()
        somewhere = {arm: np.array([1.0, 0.0, 0.0]) for arm in arms}
        return tuple(not_given(self._budget(somewhere, dict.fromkeys(arms))))

    def _budget(
        self, measured_M: Mapping[str, Array], parts: Mapping[str, UncertaintyParts | None]
    ) -> list[UncertaintyContribution]:
        return [
            line
            for arm, p_M in measured_M.items()
            for line in position_budget(
                self.profile, arm, self.known.get(arm, BudgetEvidence()), float(np.linalg.norm(p_M)), parts.get(arm)
            )
        ]
