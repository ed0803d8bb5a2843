"""The page's sections: anchor, title, message of one sentence, and whether the results in it still hold."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.driving.records import CollectionResult
from cellapp.cell.targets.path_records import PathResult
from cellapp.commands.discover.words import verdict_sentence
from cellapp.commands.locate.view import location_sentences
from cellapp.commands.report.before_after import best_method
from cellapp.commands.report.data import ReportData
from cellapp.commands.report.headlines import missing_results, warnings
from cellapp.commands.view.acceptance_words import judged_sentence
from cellapp.commands.view.charts import enumerated, mm
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.ground.results import CALIBRATE, CHECK, COMPENSATE, ISO9283, StageName
from cellapp.ground.times import day_of
from cellapp.interfaces.page.page_parts import PageParts
from cellapp.interfaces.page.plan_section import PlanSection
from cellapp.robot.kinematics.chain import parameter_names

_CHAIN_LENGTH = re.compile(r"[ad]\d")
"""Names of the lengths of a chain: a1, d1 and so on."""
SECTIONS: Mapping[str, tuple[str, tuple[StageName, ...]]] = {
    "judgements": ("Errors against their tolerances", (CALIBRATE,)),
    "accuracy": ("Accuracy at configurations that were not used", (CALIBRATE,)),
    "targets": ("Accuracy at targets", (COMPENSATE,)),
    "iso9283": ("Tests by ISO 9283", (ISO9283,)),
    "check": ("Check of the calibration", (CHECK,)),
    "discovery": ("Missing effects", ()),
    "residuals": ("Residuals of the geometry", (CALIBRATE,)),
    "pair": ("Inter-base transform", (CALIBRATE,)),
    "paths": ("Paths", ()),
    "station": ("Station of the tracker", ()),
    "plan": ("Plan", ()),
    "collection": ("Collecting", ()),
    "cell": ("The cell", ()),
    "parameters": ("Identified parameters", (CALIBRATE,)),
    "notes": ("Warnings, notes, what is not in this report", ()),
    "provenance": ("Provenance", ()),
}
"""Sections in their order on the page: anchor and name of the template, title, stages whose results they show even
where those are out of date."""
_OPEN = frozenset({"accuracy", "targets", "iso9283", "check", "discovery"})
"""Sections that are open at first: what was reached and found. The others hold how, and what it rests on."""


@dataclass(frozen=True)
class PageSection:
    """A folding section.

    Attributes
    ----------
    key : str
        Its anchor and the name of its template in ``sections``.
    message : str
        The section in one sentence; shown while it is folded, too.
    outdated : str
        Why the results in it no longer hold; empty if they do.
    """

    key: str
    title: str
    message: str
    outdated: str = ""

    @property
    def is_open(self) -> bool:
        """Whether it is unfolded at first."""
        return self.key in _OPEN or bool(self.outdated)


def page_sections(messages: Mapping[str, str], out_of_date: Mapping[StageName, str]) -> tuple[PageSection, ...]:
    """The sections that have a message, in their order; the others have nothing to show."""
    found = []
    for key, (title, stages) in SECTIONS.items():
        if messages.get(key):
            reasons = dict.fromkeys(out_of_date[stage] for stage in stages if stage in out_of_date)
            found.append(PageSection(key, title, messages[key], "; ".join(reasons)))
    return tuple(found)


def section_messages(data: ReportData, parts: PageParts, judgements: Sequence[Judgement]) -> dict[str, str]:
    """The message of each section; empty for those that have nothing to show."""
    return {
        "judgements": judged_sentence(judgements) if judgements else "",
        "accuracy": _accuracy_message(data),
        "targets": "" if parts.targets is None else _sentence(parts.targets.message),
        "iso9283": "" if parts.iso9283 is None else _sentence(parts.iso9283.message),
        "check": "" if parts.check is None else _sentence(parts.check.message),
        "discovery": _discovery_message(data),
        "residuals": _residuals_message(data),
        "pair": _pair_message(data.calibrate),
        "paths": "" if parts.paths is None else _paths_message(parts.paths),
        "station": "" if parts.located is None else _sentence(location_sentences(parts.located)[0]),
        "plan": "" if parts.plan is None else _plan_message(parts.plan),
        "collection": _collection_message(parts.collection),
        "cell": _cell_message(data),
        "parameters": _parameters_message(data),
        "notes": _notes_message(data),
        "provenance": _provenance_message(data),
    }


def _accuracy_message(data: ReportData) -> str:
    """Mean held-out errors of each arm and of the pair with the nominal and the best model."""
    parts = []
    for name, arm in data.calibrate.arms.items():
        if not arm.converged:
            parts.append(f"arm {name} did not converge")
            continue
        best = arm.validate_[arm.best_stage].position_mm.mean
        nominal = f" (nominal {mm(arm.validate_['nominal'].position_mm.mean)})" if "nominal" in arm.validate_ else ""
        parts.append(f"arm {name} {mm(best)}{nominal}")
    method = best_method(data.calibrate)
    if method is not None:
        pair = data.calibrate.pair
        nominal = f" (nominal {mm(pair['nominal'].cooperative_mm.mean)})" if "nominal" in pair else ""
        parts.append(f"distance between both arms {mm(pair[method].cooperative_mm.mean)}{nominal}")
    return f"Mean error at configurations that the calibration did not use: {'; '.join(parts)}."


def _discovery_message(data: ReportData) -> str:
    """The verdict on each arm."""
    if data.discover is None:
        return ""
    parts = [f"arm {name}, {arm.verdict}: {verdict_sentence(name, arm)}" for name, arm in data.discover.arms.items()]
    return _sentence("; ".join(parts))


def _residuals_message(data: ReportData) -> str:
    """The error that the identified geometry leaves on each arm."""
    left = {
        name: arm.validate_["geometry"].position_mm.rms
        for name, arm in data.calibrate.arms.items()
        if "geometry" in arm.validate_ and arm.converged
    }
    if not left:
        return "How the identification went, in numbers."
    parts = [f"{mm(rms)} rms on arm {name}" for name, rms in left.items()]
    return f"The identified lengths and angles alone leave {enumerated(parts)}; a pattern in the arrows is an effect."


def _pair_message(calibrate: CalibrateResult) -> str:
    """The distance of the two bases and how well both ways of identifying it agree; empty without a pair."""
    method = best_method(calibrate)
    if method is None:
        return ""
    estimates = [calibrate.pair[method].identified.get(axis) for axis in "xyz"]
    known = [estimate for estimate in estimates if estimate is not None]
    if len(known) < len(estimates):
        return "Base of the second arm in the base of the first one."
    distance = math.hypot(*(estimate.value for estimate in known))
    message = f"The bases of both arms are {distance:.4f} m apart"
    off = [estimate.value - estimate.by_tracker for estimate in known if estimate.by_tracker is not None]
    if len(off) < len(known):
        return f"{message}."
    return f"{message}; by distances alone and by the tracker's frame this differs by {mm(1e3 * math.hypot(*off))}."


def _collection_message(state: CollectionResult | None) -> str:
    """Sessions, missing readings, drift of the references; empty for imported readings."""
    if state is None:
        return ""
    count = len(state.sessions)
    parts = [f"{count} session{'s' if count != 1 else ''}"]
    missing = len(state.missing)
    parts.append(f"{missing} planned readings missing" if missing else "no planned reading missing")
    drifts = [reference.drift_mm for reference in state.references]
    if drifts:
        parts.append(f"references moved by at most {mm(max(drifts))}, limit {mm(state.drift_limit_mm)}")
    return _sentence("; ".join(parts))


def _parameters_message(data: ReportData) -> str:
    """How many parameters of each arm were identified, and the length of its chain that differs most from nominal."""
    parts = []
    for name, arm in data.calibrate.arms.items():
        nominal = data.calibrated.arms[name].nominal
        values = dict(zip(parameter_names(nominal.joints), nominal.vector().tolist(), strict=True))
        changes = {key: arm.identified[key].value - values[key] for key in arm.identified if _CHAIN_LENGTH.match(key)}
        words = f"{len(arm.identified)} parameters of arm {name}"
        if changes:
            key = max(changes, key=lambda length: abs(changes[length]))
            words += f" ({key} is off nominal most, by {changes[key] * 1e3:+.3f} mm)"
        parts.append(words)
    return f"Identified: {enumerated(parts)}."


def _cell_message(data: ReportData) -> str:
    distances = {name: float(np.linalg.norm(arm.geometry.T_M_B()[:3, 3])) for name, arm in data.model.arms.items()}
    parts = [f"arm {name} {distance:.2f} m" for name, distance in distances.items()]
    return f"Distance of the bases from the tracker: {enumerated(parts)}."


def _notes_message(data: ReportData) -> str:
    notes, missing = len(warnings(data)), len(missing_results(data))
    parts = [f"{notes} warning{'s' if notes != 1 else ''} or note{'s' if notes != 1 else ''}"] if notes else []
    parts += [f"{missing} result{'s' if missing != 1 else ''} not in this report"] if missing else []
    return f"{enumerated(parts)}." if parts else ""


def _provenance_message(data: ReportData) -> str:
    origin = data.calibrate.provenance
    count = sum(len(readings) for readings in data.readings.values())
    return (
        f"Calibrated by {origin.program} on {day_of(origin.written)} from {count} readings; hashes identify the data."
    )


def _plan_message(plan: PlanSection) -> str:
    return _sentence(plan.sentences[0]) if plan.sentences else "Where the planned stops are, and what limits them."


def _paths_message(result: PathResult) -> str:
    refused = sum(bool(path.refusal) for path in result.paths)
    words = f"{len(result.paths) - refused} of {len(result.paths)} paths can be driven"
    measured = [path.driven for path in result.paths if path.driven is not None]
    return f"{words}; {len(measured)} were driven." if measured else f"{words}."


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
