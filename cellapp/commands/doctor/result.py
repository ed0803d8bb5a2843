"""Results of init, doctor, emulate and tracker-bridge."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Record, Result


class InitResult(Result):
    """``init``: the profile that was written, and what is to be known about it; ``readings`` are the converted ones."""

    schema_: Literal["cellapp-init"] = "cellapp-init"
    version: Literal[1] = 1
    profile: str
    notes: tuple[str, ...] = ()
    readings: str | None = None
    omitted_when_none = frozenset({"readings"})


class DeviceReport(Record):
    """What a device says of itself; ``joints_c`` and ``air_c`` are in degC, what is not reported is left out."""

    model: str | None = None
    serial: str | None = None
    software: str | None = None
    state: str | None = None
    joints_c: tuple[float, ...] | None = None
    air_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None
    omitted_when_none = frozenset(
        {"model", "serial", "software", "state", "joints_c", "air_c", "pressure_hpa", "humidity_percent"}
    )


class Finding(Record):
    """One check of the doctor; ``device`` is with the finding about a device as a whole."""

    subject: str
    status: Literal["ok", "warning", "failed"]
    text: str
    device: DeviceReport | None = None
    omitted_when_none = frozenset({"device"})


class DoctorResult(Result):
    """``doctor``: what was checked."""

    schema_: Literal["cellapp-doctor"] = "cellapp-doctor"
    version: Literal[1] = 1
    findings: tuple[Finding, ...]

    @property
    def failed(self) -> tuple[Finding, ...]:
        """What would keep a job from starting."""
        return tuple(finding for finding in self.findings if finding.status == "failed")


class EmulatedController(Record):
    """The UR controller that is emulated; ``rows`` are its D-H rows theta, d, a, alpha [rad, m, m, rad]."""

    series: str
    model: str
    serial: str
    rows: tuple[tuple[float, float, float, float], ...]
    checksums: tuple[int, ...]
    calibration_status: int


class EmulatedArm(Record):
    """An emulated arm: its controller and where that listens; ``control_port`` on 127.0.0.1 takes faults on command."""

    arm: str
    controller: EmulatedController
    host: str
    dashboard_port: int
    primary_port: int
    script_port: int
    rtde_port: int
    control_port: int


class EmulatedTracker(Record):
    """Where the tracker of the simulated cell is served over the bridge protocol."""

    host: str
    port: int


class EmulateResult(Result):
    """``emulate``: what is served; ``pace`` is simulated seconds per real second."""

    schema_: Literal["cellapp-emulate"] = "cellapp-emulate"
    version: Literal[1] = 1
    pace: float
    arms: tuple[EmulatedArm, ...]
    tracker: EmulatedTracker | None


class TrackerBridgeResult(Result):
    """``tracker-bridge``: which kind of tracker is served, where, and whether a token guards it."""

    schema_: Literal["cellapp-tracker-bridge"] = "cellapp-tracker-bridge"
    version: Literal[1] = 1
    kind: str
    host: str
    port: int | None
    serial: str | None
    guarded: bool
