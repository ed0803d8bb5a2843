"""The verb ``doctor``: what is reachable, what is missing, what would be refused, and what plug-ins add."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from cellapp.cell.driving.cell import require_devices
from cellapp.cell.driving.diagnosis import controller_files, examine, factory_findings, factory_tables
from cellapp.cell.exports.formats import all_formats
from cellapp.cell.profile import load_profile
from cellapp.cell.profile.loader import explained
from cellapp.cell.targets.targets import named_targets
from cellapp.commands.doctor.bundle import bundle, newest_run, run_log
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import DoctorResult, ProfileValue
from cellapp.commands.record import Work
from cellapp.estimation.calibration.calibrate import planned_splits
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.outputs import write_new
from cellapp.ground.profile import Profile
from cellapp.ground.profile.device_plugins import device_plugins
from cellapp.robot.effects import EFFECTS
from cellapp.robot.effects.registry import in_words
from drivers.arms.protocol import ArmError
from drivers.findings import Finding


def run(request: DoctorRequest, work: Work) -> DoctorResult:
    """Check everything that the profile names; on request write what the controllers report of themselves."""
    profile = load_profile(request.profile)
    log = {} if request.bundle is None else run_log(request.run_folder or newest_run(profile))
    began_s = time.monotonic()
    result = examine_run(profile)
    if _end_left_programs(profile, result, work):
        result = examine_run(profile)
    result = result.model_copy(update={"findings": (*result.findings, *run_findings(profile, request.profile))})
    if request.explain:
        values = tuple(ProfileValue(key=key, value=value, origin=at) for key, value, at in explained(request.profile))
        result = result.model_copy(update={"profile": values})
    seconds = time.monotonic() - began_s
    if request.bundle is not None:
        work.outputs.write(request.bundle, bundle(request.profile, profile, result, log, seconds))
        result = result.model_copy(update={"written": (request.bundle,)})
    if request.controllers is None:
        return result
    if not result.controllers:
        raise InputError("--controllers: no controller reports a calibration of its own; nothing was written")
    own = {name: (its.deltas, its.checksum) for name, its in result.controllers.items()}
    files = {request.controllers / name: text for name, text in controller_files(profile, own).items()}
    written = (*(result.written or ()), *write_new(files, work.outputs))
    return result.model_copy(update={"written": written})


def _end_left_programs(profile: Profile, found: DoctorResult, work: Work) -> bool:
    """Ask for each arm on which a program of a cellapp runs whether to end it; return whether one was ended."""
    failed, ended = {finding.subject for finding in found.findings if finding.status == "failed"}, False
    for name, arm in profile.arms.items():
        user = arm.driver.left_program() if f"arm {name}: program" in failed else ""
        words = f"arm {name}: a program of {user}, runs on its controller. A job that still uses it will stop. End it?"
        if user and work.choose(words, ("no", "yes")) == "yes":
            try:
                arm.driver.end_program()
            except ArmError as error:
                raise HardwareError(f"arm {name}: {error}") from error
            ended = True
    return ended


def examine_run(profile: Profile) -> DoctorResult:
    """Return the findings of ``examine``, after those on plug-ins, as the verb's result."""
    found = DoctorResult(findings=(*installed_findings(), *examine(profile)))
    tables = factory_tables(profile, _reports(found))
    if not tables:
        return found
    findings = (*found.findings, *factory_findings(profile, tables))
    return found.model_copy(update={"findings": findings, "controllers": tables})


def _reports(result: DoctorResult) -> dict[str, tuple[tuple[tuple[float, ...], ...], str]]:
    """Return the D-H rows and checksum that each arm's controller reported."""
    return {
        finding.subject.removeprefix("arm ").removesuffix(": link"): (device.dh_rows, device.dh_checksum)
        for finding in result.findings
        if (device := finding.device) is not None and device.dh_rows is not None and device.dh_checksum
    }


def needs(profile: Profile, path: Path, sweeps: int | None = None) -> dict[str, Callable[[], object]]:
    """What ``run`` needs of a profile at ``path`` before it plans -> callable that raises ``InputError`` without it."""
    from cellapp.cell.planning.plan import require_plannable  # late: for a faster start

    return {
        "devices": partial(require_devices, profile),
        "targets": partial(named_targets, profile, path),
        "splits": partial(planned_splits, profile, sweeps),
        "plan": partial(require_plannable, profile),
    }


def run_findings(profile: Profile, path: Path) -> Iterator[Finding]:
    """Yield what the verb ``run`` would refuse before it measures, or do otherwise, by the functions that it calls.

    A cell without any device is one for readings of a file: there this is a warning.
    """
    driven = any(arm.driver.has_device for arm in profile.arms.values())
    for subject, need in needs(profile, path).items():
        try:
            found = need()
        except InputError as error:
            yield Finding(subject, "failed" if driven else "warning", str(error))
        else:
            yield from (Finding(subject, "warning", note) for note in getattr(found, "notes", ()))
        if not driven:
            return


def installed_findings() -> list[Finding]:
    """Return what each installed plug-in adds; unusable plug-ins are only warnings and stop no job."""
    installed = (*device_plugins(), *EFFECTS.plugins, *all_formats().plugins)
    added = in_words(one for one in installed if not one.problem)
    findings = [Finding(f"plug-in {name}", "ok", f"adds {words}") for name, words in added.items()]
    refused = dict.fromkeys(one.refusal for one in installed if one.problem)  # an unreadable list has no group
    return [*findings, *(Finding("plug-in", "warning", words) for words in refused)]
