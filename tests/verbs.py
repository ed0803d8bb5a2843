"""Verbs on an open run, as an interface asks for them: by a request and the work that it gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.records import CollectResult
from cellapp.cell.driving.requests import running_job
from cellapp.cell.exports.arm_export import ExportResult
from cellapp.cell.programs.records import CorrectResult
from cellapp.cell.run import RunFile
from cellapp.cell.targets.records import VerifyResult
from cellapp.cell.targets.targets import Target
from cellapp.commands import import_
from cellapp.commands.certificate import request as certificate
from cellapp.commands.certificate.run import certify
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.check import request as check
from cellapp.commands.check.locate import locate_run as locate_asked
from cellapp.commands.check.run import check_run as check_asked
from cellapp.commands.collect.request import CollectRequest
from cellapp.commands.collect.run import collect_planned
from cellapp.commands.compensate import request as compensate
from cellapp.commands.compensate.program import correct
from cellapp.commands.export import request as export
from cellapp.commands.export.run import export as export_asked
from cellapp.commands.import_ import ImportResult
from cellapp.commands.plan.result import PlanResult
from cellapp.commands.plan.run import new_planned_run, plan_result
from cellapp.commands.push import request as push
from cellapp.commands.push.run import push_targets
from cellapp.commands.record import Work
from cellapp.commands.report.request import ReportRequest
from cellapp.commands.report.run import run as report
from cellapp.commands.run_results import ReportResult
from cellapp.estimation.monitoring.records import CheckResult, LocateResult
from cellapp.ground.control import JobControl
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Plant

Opened = Callable[..., AbstractContextManager[Cell]]
"""A replacement of ``open_cell``."""
Page = Callable[[CertificateResult], str]


def certificate_run(run: RunFile, page: Page, now: datetime | None = None, **asked: Any) -> CertificateResult:
    request: Any = certificate.VERB.asked({"folder": run.folder, **asked})
    return certify(run, request, Work(certificate_page=page), now)


def check_run(
    run: RunFile, control: JobControl | None = None, *, simulated_plant: Plant | None = None, **asked: Any
) -> CheckResult:
    request: Any = check.VERB.asked({"folder": run.folder, **asked})
    return check_asked(run, request, Work(control or JobControl()), simulated_plant)


@contextmanager
def opened_by(opened: Opened) -> Iterator[None]:
    """Let jobs open their cell by ``opened``."""
    module = "cellapp.cell.driving.{}.open_cell"
    with patch(module.format("collect"), opened), patch(module.format("supervision"), opened):
        yield


def collect_by(opened: Opened, run: RunFile, control: JobControl | None = None, **options: Any) -> CollectResult:
    with opened_by(opened):
        return collect_run(run, control, **options)


def collect_stops(run: RunFile, **asked: Any) -> CollectResult:
    return collect_planned(run, CollectRequest(folder=run.folder, **asked), Work())


def correct_run(run: RunFile, program: Path, out: Path, arm: str | None = None, **asked: Any) -> CorrectResult:
    request: Any = compensate.VERB.asked({"folder": run.folder, "targets": program, "out": out, "arm": arm, **asked})
    return correct(run, request)


def export_as_run(
    run: RunFile, form: str, out: Path, arm: str | None = None, stage: str | None = None, outputs: Outputs = NEW_ONLY
) -> ExportResult:
    values = {"folder": run.folder, "form": form, "out": out, "arm": arm, "stage": stage}
    request: Any = export.VERB.asked(values)
    return export_asked(run, request, outputs)


def import_new_run(
    profile: Profile,
    csv: Path | None,
    folder: Path,
    recordings: tuple[Sequence[Path], Sequence[Path]] = ((), ()),
    **asked: Any,
) -> ImportResult:
    values = {"profile": Path("profile.yaml"), "csv": csv, "folder": folder, **asked}
    request: Any = import_.VERB.asked({**values, "joints": tuple(recordings[0]), "points": tuple(recordings[1])})
    return import_.import_new_run(profile, request)


def locate_run(
    run: RunFile,
    stops: int | None = None,
    control: JobControl | None = None,
    *,
    ask: Callable[[str], bool] | None = None,
    **opening: Any,
) -> LocateResult:
    request: Any = check.VERB.asked({"folder": run.folder, "tracker_moved": True, "stops": stops})
    return locate_asked(run, request, Work(control or JobControl(), lambda profile_name: ask), **opening)


def plan_new_run(profile: Profile, folder: Path, **asked: Any) -> PlanResult:
    with new_planned_run(profile, folder, **asked) as run:
        return plan_result(run)


def push_run(
    run: RunFile,
    targets: Sequence[Target],
    control: JobControl | None = None,
    *,
    ask: Callable[[str], bool] | None = None,
    **asked: Any,
) -> VerifyResult:
    request: Any = push.VERB.asked({"folder": run.folder, "targets": tuple(targets), **asked})
    control = control or JobControl()
    with running_job(run, control, request.job_name() or "push"):
        return push_targets(run, request, Work(control, lambda profile_name: ask))


def report_run(run: RunFile, write_page: Callable[[RunFile], Path]) -> ReportResult:
    return report(ReportRequest(folder=run.folder), Work(write_page=write_page))
