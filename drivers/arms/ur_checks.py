"""Checks that a UR controller is the expected one and that its arm can be moved as intended.

The same list serves the doctor, which moves nothing, and ``UrArm.connect``, which refuses if one fails.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import ArmError, JointLimits, LimitExceeded, LinkLost, NotInRemoteControl, WrongRobot, stale
from drivers.arms.ur_links import other_user, printable
from drivers.arms.ur_probe import UrProbe
from drivers.arms.ur_rtde_reader import SLIDER_DOWN, mode_remedy, safety_error, safety_remedy
from drivers.findings import Status

JOINTS = 6
END_COMMAND = "'cellapp doctor PROFILE' at a terminal"

_LIMIT_SLACK_RAD = 1e-3
_RATE_SLACK = 1e-3
_TCP_SLACK_M, _TCP_SLACK_RAD = 5e-4, 2e-3
"""Tolerance for the rounding of values typed on the pendant."""


@dataclass(frozen=True)
class UrExpectation:
    """The expected arm and the motions that will be requested.

    Attributes
    ----------
    model : str
        Sales name: "UR10", "UR5e".
    serial, checksum : str or None
        Serial number of the controller; checksum of its D-H parameters at the last calibration. None: not compared.
    limits : JointLimits
        Positions, speeds and accelerations that will be requested, six joints.
    payload_kg, payload_center_m : float, array of shape (3,)
        Mass on the flange, centre of mass in the flange frame [m].
    tcp : array, shape (6,), or None
        Tool centre point: position [m], rotation vector [rad]; None: not compared.
    payload_slack_kg, payload_slack_m : float
        Accepted deviation of the payload configured in the controller.
    simulation : bool
        Whether the controller must be in simulation mode, in which no arm moves; if False, it must not be.
    """

    model: str
    serial: str | None
    limits: JointLimits
    payload_kg: float
    payload_center_m: NDArray[np.float64]
    tcp: NDArray[np.float64] | None = None
    checksum: str | None = None
    payload_slack_kg: float = 0.05
    payload_slack_m: float = 0.01
    simulation: bool = False


@dataclass(frozen=True)
class Check:
    """Result of one check. ``error`` is the exception that ``connect`` raises if the check has failed."""

    subject: str
    status: Status
    text: str
    error: type[ArmError] = ArmError


def checks(expected: UrExpectation, probe: UrProbe) -> list[Check]:
    """Return all checks that need no motion, in the order in which a person would correct the findings."""
    return [
        _model(expected, probe),
        _serial(expected, probe),
        _safety(probe),
        _robot_mode(probe),
        _remote_control(probe),
        _real_robot(expected, probe),
        _program(probe),
        *(_port(port, is_open) for port, is_open in probe.ports.items()),
        _state(probe),
        _slider(probe),
        _payload(expected, probe),
        _tcp(expected, probe),
        _limits(expected, probe),
        _kinematics(expected, probe),
    ]


def load_checks(expected: UrExpectation, probe: UrProbe, answer: Mapping[str, Any]) -> list[Check]:
    """Check payload, TCP and speed slider again, as the running control program sees them.

    ``answer`` is the worker's state with the tool centre point; what it does not report is taken from the ``probe``.
    """
    sample, center, tcp = probe.sample, answer["payload_center_m"], answer["tcp"]
    if sample is not None:
        sample = replace(
            sample,
            payload_kg=answer["payload_kg"],
            payload_center_m=None if center is None else tuple(center),
            speed_fraction=answer["speed_fraction"],
        )
    now = replace(probe, sample=sample, tcp=probe.tcp if tcp is None else tuple(tcp))
    return [_slider(now), _payload(expected, now), _tcp(expected, now)]


def _model(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, model = "model", expected.model.strip()
    if probe.full_model is None:
        return Check(subject, "warning", f"the controller does not report its model; check that it is a {model}")
    if probe.full_model.casefold() == model.casefold():
        return Check(subject, "ok", probe.full_model)
    text = (
        f"the controller drives a {probe.full_model}, the profile names a {model}; check driver.host (are the arms"
        " swapped?) and type"
    )
    return Check(subject, "failed", text, WrongRobot)


def _serial(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, reported = "serial", probe.serial
    if reported is None:
        known = f"{expected.serial} could not be compared" if expected.serial else "it cannot be compared"
        text = f"the controller does not report its serial number (PolyScope before 3.12 or 5.6?); {known}"
        return Check(subject, "warning", text)
    if expected.serial is None:
        text = f'{reported}; not in the profile: add driver.serial: "{reported}" to be sure of the right arm'
        return Check(subject, "warning", text)
    if expected.serial.strip() == reported:
        return Check(subject, "ok", reported)
    text = f"the controller's is {reported}, the profile states {expected.serial}; check driver.host and driver.serial"
    return Check(subject, "failed", text, WrongRobot)


def _safety(probe: UrProbe) -> Check:
    subject, mode, status = "safety", probe.safety_mode, probe.safety_status
    if mode is None:
        return Check(subject, "failed", "the controller does not report its safety mode; look at the pendant")
    if mode != "NORMAL":
        return Check(subject, "failed", f"{mode}: {safety_remedy(mode)}", safety_error(mode))
    if status not in (None, "NORMAL"):
        return Check(subject, "failed", f"mode NORMAL, but status {status}; look at the pendant", safety_error(status))
    return Check(subject, "ok", "NORMAL")


def _robot_mode(probe: UrProbe) -> Check:
    subject, mode = "robot mode", probe.robot_mode
    if mode == "RUNNING":
        return Check(subject, "ok", "RUNNING: powered, brakes released")
    if mode is None:
        return Check(subject, "failed", "the controller does not report its mode; look at the pendant")
    return Check(subject, "failed", f"{mode}, needed is RUNNING; {mode_remedy(mode)}")


def _remote_control(probe: UrProbe) -> Check:
    subject = "remote control"
    if probe.series == "CB3":
        return Check(subject, "ok", "CB3 controllers have no such switch")
    if probe.remote_control is None:
        text = "the controller does not report it (PolyScope before 5.6?); check that its pendant shows Remote"
        return Check(subject, "warning", text)
    if probe.remote_control:
        return Check(subject, "ok", "on")
    text = "off; enable it (Settings > System > Remote Control), then switch the pendant from Local to Remote"
    return Check(subject, "failed", text, NotInRemoteControl)


def _real_robot(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, real = "real robot", probe.real_robot
    if real is None and not expected.simulation:
        return Check(subject, "ok", "the controller does not report whether it is in simulation mode")
    if expected.simulation:
        if real is False:
            return Check(subject, "ok", "off: the controller is in simulation mode, no arm moves")
        has = "it drives the real arm" if real else "the controller does not report its mode"
        return Check(subject, "failed", f"{has}; a rehearsal in simulation needs Simulation on the pendant's footer")
    if real:
        return Check(subject, "ok", "on")
    text = "off: the controller is in simulation mode, and its arm would not move; choose Real Robot on the pendant"
    return Check(subject, "failed", text)


def _program(probe: UrProbe) -> Check:
    subject = "program"
    if probe.program_running is None:
        return Check(subject, "warning", "the controller does not report whether a program runs; look at the pendant")
    if probe.program_running:
        return Check(subject, "failed", held_by(probe.program))
    if probe.sample is not None and probe.sample.program in ("PAUSED", "PAUSING", "RESUMING"):
        return Check(subject, "failed", held_by(probe.program, "is paused; it would go on where it was"))
    return Check(subject, "ok", "none runs")


def held_by(program: str | None, does: str = "runs, and the arm may move") -> str:
    """Return who holds a controller by a program of that name, and what to do about it."""
    if user := other_user(program or ""):
        return (
            f"{user}, holds the arm: its program {does}; wait for the end of that job, or stop it there. If it has"
            f" ended, {END_COMMAND} ends the program after one question"
        )
    name = "" if not program or program.startswith("<") else f" ({printable(program)})"
    return f"a program{name} that is not this driver's {does}; stop it on the pendant before a job"


def _port(port: int, is_open: bool) -> Check:
    if is_open:
        return Check(f"port {port}", "ok", "accepts a connection")
    text = "no connection; check the network's firewall and, on e-Series, Settings > Security > Services"
    return Check(f"port {port}", "failed", text, LinkLost)


def inputs(taken: bool) -> Check:
    """Return whether the input registers of RTDE are free for the client that moves the arm."""
    if not taken:
        return Check("RTDE inputs", "ok", "free")
    text = "another client (a fieldbus, another program, a job of this one) holds them; end that"
    return Check("RTDE inputs", "failed", text)


def _state(probe: UrProbe) -> Check:
    subject, sample = "state", probe.sample
    if sample is None:
        text = f"could not be read: {probe.sample_note}; see what the pendant shows, and check the network"
        return Check(subject, "failed", text, LinkLost)
    if not sample.at_rest:
        return Check(subject, "failed", "the arm moves; wait until it rests, or stop what moves it on the pendant")
    where = ", ".join(f"{np.degrees(angle):.1f}" for angle in sample.q)
    return Check(subject, "ok", f"at rest at [{where}] deg")


def _slider(probe: UrProbe) -> Check:
    subject = "speed slider"
    fraction = None if probe.sample is None else probe.sample.speed_fraction
    if fraction is None:
        return Check(subject, "warning", "the controller does not report it; set it to 100 % on the pendant")
    if fraction < SLIDER_DOWN:
        return Check(subject, "failed", "at 0 %: the arm would not move; raise it on the pendant")
    if fraction < 1.0 - _RATE_SLACK:
        return Check(subject, "warning", f"at {fraction:.0%}: motions take longer")
    return Check(subject, "ok", "100 %")


def _payload(expected: UrExpectation, probe: UrProbe) -> Check:
    subject = "payload"
    wanted = f"{expected.payload_kg:.3f} kg at {_millimetres(expected.payload_center_m)}"
    sample = probe.sample
    if sample is None or sample.payload_kg is None:
        return Check(
            subject, "warning", f"the controller does not report it; check that its installation says {wanted}"
        )
    center = None if sample.payload_center_m is None else np.array(sample.payload_center_m)
    has = f"{sample.payload_kg:.3f} kg" + ("" if center is None else f" at {_millimetres(center)}")
    heavy = max(expected.payload_kg, sample.payload_kg) > expected.payload_slack_kg  # a payload of zero has no centre
    off = 0.0 if center is None or not heavy else float(np.abs(center - expected.payload_center_m).max())
    if abs(sample.payload_kg - expected.payload_kg) <= expected.payload_slack_kg and off <= expected.payload_slack_m:
        return Check(subject, "ok", has)
    text = (
        f"the controller is configured with {has}, the profile states {wanted}; set it on the pendant or"
        " correct payload"
    )
    return Check(subject, "failed", text)


def _tcp(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, tcp = "TCP", probe.tcp
    if tcp is None:
        if expected.tcp is None:
            return Check(subject, "ok", "not reported, and not stated in the profile")
        return Check(
            subject, "warning", f"the controller does not report it; check that it is {_tcp_text(expected.tcp)}"
        )
    has = _tcp_text(np.array(tcp))
    if expected.tcp is None:
        return Check(subject, "ok", f"{has}; not stated in the profile (driver.tcp), so not compared")
    off = np.abs(np.array(tcp) - expected.tcp)
    if off[:3].max() <= _TCP_SLACK_M and off[3:].max() <= _TCP_SLACK_RAD:
        return Check(subject, "ok", has)
    text = f"the controller's is {has}, the profile states {_tcp_text(expected.tcp)}; choose it on the pendant"
    return Check(subject, "failed", text)


def _limits(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, limits, wanted = "joint limits", probe.limits, expected.limits
    if limits is None:
        return Check(subject, "warning", "the controller does not report its joint limits; compare them on the pendant")
    excess = []
    for joint in range(JOINTS):
        low, high = limits.position[joint]
        asked_low, asked_high = wanted.position[joint]
        if asked_low < low - _LIMIT_SLACK_RAD or asked_high > high + _LIMIT_SLACK_RAD:
            excess.append(
                f"joint {joint + 1} may go from {np.degrees(low):.1f} to {np.degrees(high):.1f} deg, the profile asks"
                f" for {np.degrees(asked_low):.1f} to {np.degrees(asked_high):.1f}"
            )
        if wanted.speed[joint] > limits.speed[joint] * (1.0 + _RATE_SLACK):
            excess.append(
                f"joint {joint + 1} may rotate at {np.degrees(limits.speed[joint]):.1f} deg/s, the profile asks for"
                f" {np.degrees(wanted.speed[joint]):.1f}"
            )
    if excess:
        text = f"{'; '.join(excess)}; tighten limits or speed_scale in the profile, or widen them on the pendant"
        return Check(subject, "failed", text, LimitExceeded)
    return Check(subject, "ok", "as wide as the profile's")


def _kinematics(expected: UrExpectation, probe: UrProbe) -> Check:
    subject, found = "kinematics", probe.kinematics
    if found is None:
        return Check(subject, "warning", f"the controller's own D-H could not be read: {probe.kinematics_note}")
    if expected.checksum is not None and expected.checksum.strip().lower() != found.checksum:
        return Check(subject, "warning", stale(expected.checksum.strip().lower(), found.checksum))
    if not found.checksum:
        return Check(subject, "ok", "D-H without a factory calibration read")
    return Check(subject, "ok", f"factory-calibrated D-H read, checksum {found.checksum}")


def _millimetres(point: NDArray[np.float64]) -> str:
    return "[" + ", ".join(f"{1e3 * value:.1f}" for value in point) + "] mm"


def _tcp_text(tcp: NDArray[np.float64]) -> str:
    return f"{_millimetres(tcp[:3])} [{', '.join(f'{value:.4f}' for value in tcp[3:])}] rad"
