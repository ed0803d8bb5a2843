"""The verb: what is reachable, what is missing, what would be refused. Looks only; nothing moves."""

from __future__ import annotations

import importlib.util
import platform
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellapp.collection.cell import build_plant
from cellapp.errors import InputError
from cellapp.planning.bodies import place
from cellapp.planning.cell_bodies import cell_bodies, home_positions
from cellapp.planning.safety import CellBodies, clear_alone, refuse_stop, visible
from cellapp.profile import Arm, Profile, UrArmDriver
from drivers.arms.protocol import ArmError
from drivers.arms.ur import UrProbe, probe_ur

Status = Literal["ok", "warning", "failed"]
Probe = Callable[[str, float], UrProbe]

LONGEST_PROBE_S = 5.0
"""A controller that has not answered by then counts as dead, however long the profile would wait for it."""

_DRAWS = 2000
_FEW_SEEN = 0.002
_OLDEST_PYTHON, _FIRST_UNTRIED_PYTHON = (3, 11), (3, 13)
_SAFETY_REMEDY = {
    "REDUCED": "it obeys the reduced limits; leave the area that triggers them, or expect slower motion",
    "PROTECTIVE_STOP": "go to the arm, see what stopped it, clear the cause, then enable the robot on the pendant",
    "RECOVERY": "a limit is exceeded: jog the arm back inside on the pendant",
    "SAFEGUARD_STOP": "close the guard or clear the light curtain, then reset the safeguard",
    "SYSTEM_EMERGENCY_STOP": "an emergency stop of the cell is pressed: find out why, release it, power the arm on",
    "ROBOT_EMERGENCY_STOP": "the pendant's emergency stop is pressed: find out why, release it, power the arm on",
    "VIOLATION": "a safety limit was violated: read the pendant's log, then restart the safety system there",
    "FAULT": "the safety system is at fault: read the pendant's log, then restart it there",
}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: whether it is as needed and, where not, what to do."""

    subject: str
    status: Status
    text: str


def examine(profile: Profile, probe: Probe = probe_ur) -> list[Finding]:
    """Look at all that a profile names. Takes little longer than ``LONGEST_PROBE_S``, however many hosts are dead.

    ``probe`` asks a UR controller at a host within a time [s]. Nothing raises for what is found; see the findings.
    """
    hosts = {name: arm.driver for name, arm in profile.arms.items() if isinstance(arm.driver, UrArmDriver)}
    findings = [_python(needs_ur_rtde=bool(hosts))]
    with ThreadPoolExecutor(max_workers=max(1, len(hosts)), thread_name_prefix="probe") as pool:
        asked = {
            name: pool.submit(probe, driver.host, min(driver.timeout, LONGEST_PROBE_S))
            for name, driver in hosts.items()
        }
        standing = _standing(profile)
        for name, arm in profile.arms.items():
            findings += _arm(name, arm, hosts, asked)
        findings.append(_tracker(profile))
    return findings + standing


def _python(needs_ur_rtde: bool) -> Finding:
    version = platform.python_version()
    if not _OLDEST_PYTHON <= sys.version_info[:2] < _FIRST_UNTRIED_PYTHON:
        return Finding("python", "failed", f"Python {version}; needed is 3.11 or 3.12: ur-rtde has no build for others")
    missing = [name for name in ("rtde_control", "rtde_receive") if importlib.util.find_spec(name) is None]
    if not missing:
        return Finding("python", "ok", f"Python {version}, ur-rtde is installed")
    text = f"Python {version}; ur-rtde is not installed"
    if needs_ur_rtde:
        return Finding("python", "failed", f"{text}; UR arms need it: pip install ur-rtde")
    return Finding("python", "ok", f"{text}, and this profile does not need it")


# -- arms -------------------------------------------------------------------------------------------------------------


def _arm(name: str, arm: Arm, hosts: Mapping[str, UrArmDriver], asked: Mapping[str, Future[UrProbe]]) -> list[Finding]:
    subject = f"arm {name}"
    match arm.driver.kind:
        case "none":
            return [Finding(subject, "ok", "no device: readings come from a file")]
        case "simulated":
            return [Finding(subject, "ok", f"simulated {arm.type.model}; no hardware is touched")]
        case "ur":
            driver = hosts[name]
            same = [other for other, its in hosts.items() if other != name and its.host == driver.host]
            findings = []
            if same:
                text = f"host {driver.host} is also that of arm {', '.join(same)}; give each arm its own controller"
                findings.append(Finding(f"{subject}: address", "failed", text))
            try:
                said = asked[name].result()
            except ArmError as error:
                return [*findings, Finding(f"{subject}: link", "failed", str(error))]
            return findings + _ur(subject, arm, driver, said)


def _ur(subject: str, arm: Arm, driver: UrArmDriver, said: UrProbe) -> list[Finding]:
    at = f"{said.series} controller at {said.host}, PolyScope {said.software}"
    findings = [
        Finding(f"{subject}: link", "ok", at),
        Finding(f"{subject}: model", *_model(arm.type.model, said)),
        Finding(f"{subject}: serial", *_serial(driver.serial, said.serial)),
        Finding(f"{subject}: safety", *_safety(said)),
        Finding(f"{subject}: robot mode", *_robot_mode(said.robot_mode)),
    ]
    if said.series != "CB3":
        findings.append(Finding(f"{subject}: remote control", *_remote_control(said.remote_control)))
    findings.append(Finding(f"{subject}: program", *_program(said.program_running)))
    findings += [Finding(f"{subject}: port {port}", *_port(open_)) for port, open_ in said.ports.items()]
    findings.append(Finding(f"{subject}: kinematics", *_kinematics(said)))
    cannot = "this version can examine a UR controller but not move its arm; 'collect' would be refused"
    findings.append(Finding(f"{subject}: motion", "failed", cannot))
    return findings


def _model(expected: str, said: UrProbe) -> tuple[Status, str]:
    if said.full_model is None:
        return "warning", f"the controller does not tell its model; check that it is a {expected}"
    if said.full_model.casefold() == expected.strip().casefold():
        return "ok", said.full_model
    return "failed", (
        f"the controller drives a {said.full_model}, the profile names a {expected}; check driver.host (are the arms"
        " swapped?) and type"
    )


def _serial(expected: str | None, reported: str | None) -> tuple[Status, str]:
    if reported is None:
        known = f"{expected} could not be compared" if expected else "it cannot be compared"
        return "warning", f"the controller does not tell its serial number (PolyScope before 3.12 or 5.6?); {known}"
    if expected is None:
        return "warning", f'{reported}; not in the profile: add driver.serial: "{reported}" to be sure of the right arm'
    if expected.strip() == reported:
        return "ok", reported
    return "failed", f"the controller's is {reported}, the profile says {expected}; check driver.host and driver.serial"


def _safety(said: UrProbe) -> tuple[Status, str]:
    mode = said.safety_mode
    if mode is None:
        return "failed", "the controller does not tell its safety mode; look at the pendant"
    if mode == "NORMAL":
        if said.safety_status not in (None, "NORMAL"):
            return "failed", f"mode NORMAL, but status {said.safety_status}; look at the pendant"
        return "ok", "NORMAL"
    remedy = _SAFETY_REMEDY.get(mode, "look at the pendant")
    return "warning" if mode == "REDUCED" else "failed", f"{mode}: {remedy}"


def _robot_mode(mode: str | None) -> tuple[Status, str]:
    if mode == "RUNNING":
        return "ok", "RUNNING: powered, brakes released"
    if mode is None:
        return "failed", "the controller does not tell its mode; look at the pendant"
    return "failed", f"{mode}, needed is RUNNING; power the arm on and release its brakes on the pendant"


def _remote_control(remote: bool | None) -> tuple[Status, str]:
    if remote is None:
        return "warning", "the controller does not tell (PolyScope before 5.6?); see that its pendant shows Remote"
    if remote:
        return "ok", "on"
    return "failed", "off; enable it (Settings > System > Remote Control), then switch the pendant from Local to Remote"


def _program(running: bool | None) -> tuple[Status, str]:
    if running is None:
        return "warning", "the controller does not tell whether a program runs; look at the pendant"
    if running:
        return "warning", "a program runs, and the arm may move; stop it on the pendant before a job"
    return "ok", "none runs"


def _port(is_open: bool) -> tuple[Status, str]:
    if is_open:
        return "ok", "accepts a connection"
    return "failed", "no connection; check the network's firewall and, on e-Series, Settings > Security > Services"


def _kinematics(said: UrProbe) -> tuple[Status, str]:
    found = said.kinematics
    if found is None:
        return "warning", f"the controller's own D-H could not be read: {said.kinematics_note}"
    checksums = " ".join(f"{value:08x}" for value in found.checksums)
    kind = "calibrated D-H" if found.status else "D-H without a calibration"
    return "ok", f"{kind} read, checksums {checksums}"


# -- where the arms stand ---------------------------------------------------------------------------------------------


def _standing(profile: Profile) -> list[Finding]:
    """Whether the arms may stand at home, and whether the tracker would see enough of them."""
    placed = {name: arm for name, arm in profile.arms.items() if arm.base is not None and arm.home is not None}
    if all(arm.driver.kind == "none" for arm in profile.arms.values()) or not placed or profile.tracker.pose is None:
        return []
    findings = []
    if profile.plant is not None:
        try:
            build_plant(profile)
        except InputError as error:
            findings.append(Finding("plant", "failed", str(error)))
        else:
            findings.append(Finding("plant", "ok", "the simulated cell can be built"))
    bare = [name for name, arm in placed.items() if not arm.type.capsules]
    if bare:
        text = f"arm {', '.join(bare)} has no bodies, so no collision can be foreseen; add capsules to its type"
        return [*findings, Finding("home", "failed", text)]
    cell = cell_bodies(profile.model_copy(update={"arms": placed}))
    refusal = refuse_stop(cell, home_positions(profile))
    if refusal:
        text = f"{refusal}; change arms.*.home, arms.*.base, plan.floor or plan.clearance"
        findings.append(Finding("home", "failed", text))
    else:
        findings.append(Finding("home", "ok", f"safe to stand at: {', '.join(placed)}"))
    return findings + [_visibility(cell, profile, name) for name in placed]


def _visibility(cell: CellBodies, profile: Profile, name: str) -> Finding:
    """The share of random configurations, clear of floor and self, at which the tracker sees the SMR."""
    subject = f"arm {name}: SMR"
    if profile.arms[name].smr.offset == "unknown":
        return Finding(subject, "warning", "smr.offset is unknown: the tracker will be pointed at the flange instead")
    body = cell.arms[name]
    low, high = np.maximum(body.limits[:, 0], -np.pi), np.minimum(body.limits[:, 1], np.pi)
    if profile.plan.ranges is not None:
        ranges = np.array(profile.plan.ranges)
        low, high = np.maximum(body.limits[:, 0], ranges[:, 0]), np.minimum(body.limits[:, 1], ranges[:, 1])
    low, high = np.where(low <= high, low, body.limits[:, 0]), np.where(low <= high, high, body.limits[:, 1])
    q = np.random.default_rng([profile.seed, 0xD0C]).uniform(low, high, size=(_DRAWS, len(low)))
    at = place(body, q)
    clear = clear_alone(cell, at)
    share = float((visible(cell, name, q) & clear).mean())
    seen = f"the tracker sees it in {share:.1%} of {_DRAWS} random configurations that the arm may take"
    if share >= _FEW_SEEN:
        return Finding(subject, "ok", seen)
    advice = "check smr.normal, smr.acceptance, arms.*.base, tracker.pose and the limits"
    return Finding(subject, "warning" if share > 0.0 else "failed", f"{seen}; {advice}")


# -- tracker ----------------------------------------------------------------------------------------------------------


def _tracker(profile: Profile) -> Finding:
    driver = profile.tracker.driver
    match driver.kind:
        case "none":
            return Finding("tracker", "ok", "no device: readings come from a file")
        case "simulated":
            return Finding("tracker", "ok", "simulated; no hardware is touched")
        case "lmf":
            system = platform.system() or "an unknown system"
            return Finding(
                "tracker",
                "failed",
                f"the AT960 at {driver.address} was not asked: this version has no driver for Leica's LMF. LMF needs"
                f" Windows in any case (this is {system}). Use the simulated cell, or import readings from a file",
            )
