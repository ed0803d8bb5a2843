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

from cellapp.collection.cell import air_sensor, build_plant, lmf_tracker, ur_expectation
from cellapp.collection.token import read_token
from cellapp.errors import InputError
from cellapp.profile import Arm, BridgeTrackerDriver, Profile, UrArmDriver
from cellapp.safety.bodies import place
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, clear_alone, refuse_stop, visible
from drivers.arms.protocol import ArmError
from drivers.arms.ur_checks import checks
from drivers.arms.ur_probe import UrProbe, probe_ur
from drivers.sensors.protocol import SensorError
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.protocol import TrackerError, TrackerLinkLost

Status = Literal["ok", "warning", "failed"]
Probe = Callable[[str, float], UrProbe]

LONGEST_PROBE_S = 5.0
"""A controller that has not answered by then counts as dead, however long the profile would wait for it."""

_DRAWS = 2000
_FEW_SEEN = 0.002
_OLDEST_PYTHON, _FIRST_UNTRIED_PYTHON = (3, 11), (3, 13)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: whether it is as needed and, where not, what to do."""

    subject: str
    status: Status
    text: str


def examine(profile: Profile, probe: Probe = probe_ur) -> list[Finding]:
    """Look at all that a profile names, at all devices at once. However many are dead, it takes about twice
    ``LONGEST_PROBE_S``, or what connecting to the slowest may take: a minute for LMF, a sensor's own ``timeout``.

    ``probe`` asks a UR controller at a host within a time [s]. Nothing raises for what is found; see the findings.
    """
    hosts = {name: arm.driver for name, arm in profile.arms.items() if isinstance(arm.driver, UrArmDriver)}
    findings = [_python(needs_ur_rtde=bool(hosts))]
    with ThreadPoolExecutor(max_workers=len(hosts) + 2, thread_name_prefix="probe") as pool:
        asked = {
            name: pool.submit(probe, driver.host, min(driver.timeout, LONGEST_PROBE_S))
            for name, driver in hosts.items()
        }
        tracker, sensors = pool.submit(_tracker, profile), pool.submit(_sensors, profile)
        standing = _standing(profile)
        for name, arm in profile.arms.items():
            findings += _arm(name, arm, hosts, asked)
        findings.append(tracker.result())
        findings += sensors.result()
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
            try:
                return findings + _ur(name, arm, driver, said)
            except InputError as error:
                return [*findings, Finding(f"{subject}: type", "failed", str(error))]


def _ur(name: str, arm: Arm, driver: UrArmDriver, said: UrProbe) -> list[Finding]:
    subject = f"arm {name}"
    at = f"{said.series} controller at {said.host}, PolyScope {said.software}"
    found = checks(ur_expectation(name, arm, driver), said)
    findings = [Finding(f"{subject}: link", "ok", at)]
    findings += [Finding(f"{subject}: {check.subject}", check.status, check.text) for check in found]
    against = [check.subject for check in found if check.status == "failed"]
    if against:
        text = f"would be refused because of {', '.join(against)}; nothing was tried"
        return [*findings, Finding(f"{subject}: motion", "failed", text)]
    return [*findings, Finding(f"{subject}: motion", "ok", "nothing stands against it; nothing was tried")]


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


def _bridge(driver: BridgeTrackerDriver) -> Finding:
    """Ask the tracker behind a bridge who it is; its head does not move for that."""
    try:
        token = read_token(driver.token_file, driver.token_env)
    except InputError as error:
        return Finding("tracker", "failed", str(error))
    timeout = min(driver.timeout, LONGEST_PROBE_S)
    tracker = BridgeTracker(driver.url, token=token, timeout_s=timeout, baud=driver.baud, patience_s=LONGEST_PROBE_S)
    try:
        tracker.connect()
        found = tracker.identify()
        unmet = tracker.unmet()
    except TrackerError as error:
        return Finding("tracker", "failed", str(error))
    finally:
        tracker.disconnect()
    who = f"{found.model}, serial {found.serial}, {found.software}, behind the bridge at {driver.url}"
    if unmet:
        return Finding("tracker", "warning", f"{who}; before it measures: {'; '.join(unmet)}")
    return Finding("tracker", "ok", f"{who}; ready")


def _tracker(profile: Profile) -> Finding:
    driver = profile.tracker.driver
    match driver.kind:
        case "none":
            return Finding("tracker", "ok", "no device: readings come from a file")
        case "simulated":
            return Finding("tracker", "ok", "simulated; no hardware is touched")
        case "bridge":
            return _bridge(driver)
        case "lmf":
            return _lmf(profile)


def _lmf(profile: Profile) -> Finding:
    """Ask a tracker of Leica's; settings are applied, but its head does not move for that."""
    try:
        tracker = lmf_tracker(profile)
    except InputError as error:
        return Finding("tracker", "failed", str(error))
    try:
        tracker.connect()
        found = tracker.identify()
        unmet = tracker.unmet()
        notices = tracker.notices()
    except TrackerLinkLost as error:
        return Finding("tracker", "failed", f"{error}; {tracker.visible_trackers()}")
    except (TrackerError, ValueError) as error:
        return Finding("tracker", "failed", str(error))
    finally:
        tracker.disconnect()
    who = f"{found.model}, serial {found.serial}, {found.software}"
    if unmet:
        return Finding("tracker", "warning", f"{who}; before it measures: {'; '.join([*unmet, *notices])}")
    if notices:
        return Finding("tracker", "warning", f"{who}; {'; '.join(notices)}")
    return Finding("tracker", "ok", f"{who}; ready")


# -- sensors ----------------------------------------------------------------------------------------------------------


def _sensors(profile: Profile) -> list[Finding]:
    sensor = profile.sensors.air
    if sensor is None:
        return []
    subject = "sensor air"
    if sensor.kind == "simulated":
        return [Finding(subject, "ok", "simulated; no hardware is touched")]
    station = air_sensor(profile, None)
    assert station is not None
    try:
        station.connect()
        return [Finding(subject, "ok", f"{sensor.url}: {station.read()}")]
    except SensorError as error:
        return [Finding(subject, "failed", str(error))]
    finally:
        station.disconnect()
