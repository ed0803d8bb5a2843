"""The findings of ``doctor`` as sentences."""

from __future__ import annotations

from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.profile_view import profile_tables
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.record import View
from cellapp.ground.counting import counted


def view(result: DoctorResult, request: DoctorRequest | None = None) -> View:
    """What the profile says of the cell where that is asked for, and every finding."""
    described = profile_tables(load_profile(request.profile)) if request is not None and request.cell else []
    findings = [f"{finding.status:8} {finding.subject}: {finding.text}" for finding in result.findings]
    failed = f"{len(result.failed)} of {counted(len(result.findings), 'check')} failed"
    return View((*described, *findings), (failed,) if result.failed else ())
