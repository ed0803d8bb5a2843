"""What a device reports about itself, and the result of a probe of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warning", "failed"]


DhRow = tuple[float, float, float, float]
"""theta, d, a, alpha of a joint [rad, m, m, rad]."""


@dataclass(frozen=True)
class DeviceReport:
    """What a device reports about itself; None if not reported.

    Attributes
    ----------
    model, serial, software : str or None
    state : str or None
        Its modes in its own words: "RUNNING, NORMAL".
    joints_c : tuple of float or None
        Temperature of each joint [degC].
    air_c, pressure_hpa, humidity_percent : float or None
        The air at a sensor [degC, hPa, %].
    dh_rows : tuple of rows or None
        Rows theta, d, a, alpha of each joint that a controller uses [rad, m, m, rad].
    dh_checksum : str or None
        Checksum of the controller's factory calibration; empty if it has none.
    """

    model: str | None = None
    serial: str | None = None
    software: str | None = None
    state: str | None = None
    joints_c: tuple[float, ...] | None = None
    air_c: float | None = None
    pressure_hpa: float | None = None
    humidity_percent: float | None = None
    dh_rows: tuple[DhRow, ...] | None = None
    dh_checksum: str | None = None


@dataclass(frozen=True)
class ArmIdentity:
    """Identity of the arm as reported by its controller.

    Attributes
    ----------
    dh_rows : tuple of rows or None
        D-H rows theta, d, a, alpha of each joint that the controller uses [rad, m, m, rad]; None if not reported.
    dh_checksum : str
        Checksum of the arm's factory calibration; empty if the controller has none.
    """

    model: str
    serial: str
    software: str
    dh_rows: tuple[DhRow, ...] | None = None
    dh_checksum: str = ""


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes
    ----------
    subject : str
        What was checked, in a word or two; empty for the device as a whole.
    status : {"ok", "warning", "failed"}
        Whether a job can start; a warning does not prevent it.
    text : str
        What was found and, unless it is ok, what to do.
    device : DeviceReport or None
        Report of the device, in the finding about the device as a whole.
    """

    subject: str
    status: Status
    text: str
    device: DeviceReport | None = None
