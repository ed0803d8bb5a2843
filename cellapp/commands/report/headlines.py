"""First words of the page: warnings, and results that are out of date."""

from __future__ import annotations

from cellapp.commands.report.data import ReportData
from cellapp.ground.results import CHECK, StageName

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


def unusable_arms(data: ReportData) -> list[tuple[str, str]]:
    """Return the arms whose calibration must not be used, with the reason."""
    return [
        (f"Arm {name}", f"the calibration did not converge ({arm.message}): do not use it")
        for name, arm in data.calibrate.arms.items()
        if not arm.converged
    ]


def warnings(data: ReportData) -> list[str]:
    """Return the calibration's notes, and why targets were not measured."""
    targets = () if data.verify is None else data.verify.targets
    return [*data.calibrate.notes] + [f"target {target.name}: {target.note}" for target in targets if target.note]


def out_of_date_lines(data: ReportData) -> list[tuple[str, str]]:
    """Return the title and reason of each result that no longer holds, and what a check found."""
    lines = [(STAGE_TITLES[name], reason) for name, reason in data.out_of_date.items()]
    checked = data.results.held.check
    if checked is not None and checked.found_change:
        lines += [(STAGE_TITLES[CHECK], complaint) for complaint in checked.complaints()]
    return lines
