"""The verb: what is reachable, what is missing, what would be refused, and what plug-ins add."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from cellapp.cell.driving.examination import examine, probe
from cellapp.cell.exports.formats import all_formats
from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import DeviceReport, DoctorResult
from cellapp.commands.doctor.result import Finding as ResultFinding
from cellapp.commands.record import Work
from cellapp.commands.trials.benchmark.methods.registry import METHODS
from cellapp.ground.profile import Profile
from cellapp.ground.profile.device_plugins import device_plugins
from cellapp.robot.effects import EFFECTS
from cellapp.robot.plugins import in_words
from drivers.arms.settings import ArmSettings
from drivers.findings import Finding
from drivers.plugins import Plugin
from drivers.sensors.settings import AirSensorSettings
from drivers.trackers.settings import TrackerSettings


def run(request: DoctorRequest, work: Work) -> DoctorResult:
    """Check all that the profile names."""
    return examine_run(load_profile(request.profile), request.reference_nests)


def examine_run(profile: Profile, reference_nests: Path | None = None) -> DoctorResult:
    """All that ``examine`` finds, after what plug-ins add, as the result of the verb."""
    return DoctorResult(findings=tuple(map(_result, (*installed_findings(), *examine(profile, reference_nests)))))


def repeatable_devices(profile: Profile) -> tuple[str, ...]:
    """Devices whose probe may be repeated every few seconds, as they are called in findings."""
    settings: dict[str, ArmSettings | TrackerSettings | AirSensorSettings] = {
        **{f"arm {name}": arm.driver for name, arm in profile.arms.items()},
        "tracker": profile.tracker.driver,
    }
    if profile.sensors.air is not None:
        settings["sensor air"] = profile.sensors.air
    return tuple(name for name, one in settings.items() if one.repeatable_probe)


def probe_devices(profile: Profile, devices: Collection[str]) -> DoctorResult:
    """What some devices say now; nothing moves, and nothing else is checked."""
    return DoctorResult(findings=tuple(map(_result, probe(profile, devices))))


def _result(finding: Finding) -> ResultFinding:
    return ResultFinding.like(finding, device=None if finding.device is None else DeviceReport.like(finding.device))


def installed_plugins() -> tuple[Plugin, ...]:
    """Every entry point in a group of this program, also those that are not used."""
    return (*device_plugins(), *EFFECTS.plugins, *all_formats().plugins, *METHODS.plugins)


def installed_findings() -> list[Finding]:
    """What each installed plug-in adds; those that cannot be used keep no job from starting."""
    installed = installed_plugins()
    added = in_words(one for one in installed if not one.problem)
    findings = [Finding(f"plug-in {name}", "ok", f"adds {words}") for name, words in added.items()]
    refused = dict.fromkeys(one.refusal for one in installed if one.problem)  # a list that cannot be read has no group
    return [*findings, *(Finding("plug-in", "warning", words) for words in refused)]
