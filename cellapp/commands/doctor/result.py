"""Result of ``doctor``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cellapp.ground.results import Record, Result
from drivers.findings import Status


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
    dh_rows: tuple[tuple[float, ...], ...] | None = None
    dh_checksum: str | None = None
    omitted_when_none = frozenset(
        {
            "model",
            "serial",
            "software",
            "state",
            "joints_c",
            "air_c",
            "pressure_hpa",
            "humidity_percent",
            "dh_rows",
            "dh_checksum",
        }
    )


class ControllerCalibration(Record):
    """The factory's calibration in a controller.

    ``deltas`` are added to the published rows theta, d, a, alpha of each joint [rad, m, m, rad]; ``near`` says the same
    as rows theta, d, a, alpha, beta next to them. ``mean_mm`` and ``max_mm`` are how far the SMR is off by both chains.
    """

    checksum: str
    deltas: tuple[tuple[float, ...], ...]
    near: tuple[tuple[float, ...], ...]
    mean_mm: float
    max_mm: float


class Finding(Record):
    """One check of the doctor; ``device`` is with the finding about a device as a whole."""

    subject: str
    status: Status
    text: str
    device: DeviceReport | None = None
    omitted_when_none = frozenset({"device"})


class DoctorResult(Result, schema="cellapp-doctor"):
    """``doctor``: what was checked."""

    findings: tuple[Finding, ...]
    controllers: Mapping[str, ControllerCalibration] | None = None
    """Arm -> calibration that its controller reports; None if none does."""
    written: tuple[Path, ...] | None = None
    omitted_when_none = frozenset({"controllers", "written"})

    @property
    def failed(self) -> tuple[Finding, ...]:
        """What would keep a job from starting."""
        return tuple(finding for finding in self.findings if finding.status == "failed")
