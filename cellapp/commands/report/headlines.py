"""First words of the page: headlines, warnings, results that are out of date, results that are missing."""

from __future__ import annotations

from cellapp.commands.report.before_after import best_method
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.words import METHOD_WORDS
from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult, PairMethodResult
from cellapp.estimation.discovery.records import ArmDiscoveryResult
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE, CHECK, DISCOVER, VERIFY, Method, StageName

_NO_PAIR = "pair: skipped"
"""Prefix of the calibration's note on why there is no pair."""
STAGE_TITLES: dict[StageName, str] = {
    "calibrate": "Calibration",
    "discover": "Missing effects",
    "locate": "Station of the tracker",
    "compensate": "Compensated targets",
    "push": "Pushed targets",
    "verify": "Verification at new targets",
    "path": "Compensated paths",
    "iso9283": "Tests by ISO 9283",
    "check": "Check of the calibration",
    "certificate": "Certificate",
}


def headlines(data: ReportData) -> list[tuple[str, str]]:
    """State the accuracy of each arm and of the pair at held-out configurations; only results that hold."""
    lines = []
    suffix = " (out of date)" if CALIBRATE in data.out_of_date else ""
    for name, arm in data.calibrate.arms.items():
        found = None if data.discover is None else data.discover.arms.get(name)
        lines.append((f"Arm {name}{suffix}", _arm_sentence(arm, found)))
    method = best_method(data.calibrate)
    if method is not None:
        sentence = _pair_sentence(method, data.calibrate.pair[method], data.calibrate.pair.get("nominal"))
        lines.append((f"Pair{suffix}", sentence))
    return lines


def verified_headlines(data: ReportData) -> list[tuple[str, str]]:
    """State the measured errors of each arm at targets, without and with compensation."""
    lines = []
    for name, verified in ({} if data.verify is None else data.verify.arms).items():
        before, after = verified.nominal_mm.mean, verified.compensated_mm.mean
        change = "fell" if after < before else "did not fall: it changed"
        lines.append(
            (
                f"Arm {name}, verified",
                f"At {counted(verified.compensated_mm.n, 'new target')} the measured mean error {change} from"
                f" {before:.3f} mm to {after:.3f} mm with compensation.",
            )
        )
    return lines


def unusable_arms(data: ReportData) -> list[tuple[str, str]]:
    """Return the arms whose calibration must not be used, with the reason."""
    return [
        (f"Arm {name}", f"the calibration did not converge ({arm.message}): do not use it")
        for name, arm in data.calibrate.arms.items()
        if not arm.converged
    ]


def _arm_sentence(arm: ArmCalibrationResult, found: ArmDiscoveryResult | None) -> str:
    if not arm.converged:
        return f"The calibration did not converge ({arm.message}): do not use it."
    nominal, geometry = arm.validate_["nominal"].position_mm, arm.validate_["geometry"].position_mm
    with_effects = found is not None and bool(found.accepted)
    best = arm.validate_["effects"].position_mm if with_effects else geometry
    sentence = (
        f"The mean error of the predicted SMR position is {best.mean:.3f} mm ({counted(best.n, 'configuration')}"
        f" that the calibration did not use); with the nominal geometry it is {nominal.mean:.3f} mm"
    )
    return sentence + (f", with the identified geometry alone {geometry.mean:.3f} mm." if with_effects else ".")


def _pair_sentence(method: Method, best: PairMethodResult, nominal: PairMethodResult | None) -> str:
    sentence = (
        f"The mean error of the predicted distance between the two arms' SMRs is {best.cooperative_mm.mean:.3f} mm"
        f" ({METHOD_WORDS[method]}; held-out stops)"
    )
    if method != "nominal" and nominal is not None:
        sentence += f"; with the nominal cell it is {nominal.cooperative_mm.mean:.3f} mm"
    return sentence + "."


def warnings(data: ReportData) -> list[str]:
    """Return the calibration's notes, and why targets were not measured."""
    notes = [note for note in data.calibrate.notes if not note.startswith(_NO_PAIR)]
    targets = () if data.verify is None else data.verify.targets
    return notes + [f"target {target.name}: {target.note}" for target in targets if target.note]


def out_of_date_lines(data: ReportData) -> list[tuple[str, str]]:
    """Return the title and reason of each result that no longer holds, and what a check found."""
    lines = [(STAGE_TITLES[name], reason) for name, reason in data.out_of_date.items()]
    checked = data.results.held_check
    if checked is not None and checked.found_change:
        lines += [(STAGE_TITLES[CHECK], complaint) for complaint in checked.complaints()]
    return lines


def missing_results(data: ReportData) -> list[tuple[str, str]]:
    """Return the title of each result that the run does not have, and the command that makes it."""
    missing = []
    if not data.calibrate.pair:
        title = "Pair (inter-base transform and cooperative errors)"
        missing.append((title, _why_no_pair(data.profile, data.calibrate)))
    if data.results.discover is None and DISCOVER not in data.out_of_date:
        missing.append((STAGE_TITLES[DISCOVER], "search for them with: cellapp discover DIR"))
    if data.verify is None and VERIFY not in data.out_of_date:
        missing.append((STAGE_TITLES[VERIFY], _how_to_verify(data)))
    return missing


def _why_no_pair(profile: Profile, calibrate: CalibrateResult) -> str:
    reasons = [note for note in calibrate.notes if note.startswith(_NO_PAIR)]
    reason = reasons[0].removeprefix("pair: ") if reasons else "not computed"
    two = len(profile.arms) == 2
    more = "measure more stops with both arms" if two else "measure two arms at the same stops in a new run"
    return f"{reason}; {more}, then: cellapp calibrate DIR"


def _how_to_verify(data: ReportData) -> str:
    command = "measure targets with: cellapp push DIR TARGETS --verify"
    if data.results.verify is not None:
        return f"targets were pushed, but none was measured with both commands; {command}"
    if not any(arm.driver.has_device for arm in data.profile.arms.values()):
        return f"the profile has no devices; with a profile that has, {command}"
    return command
