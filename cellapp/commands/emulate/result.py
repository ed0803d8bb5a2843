"""Result of ``emulate``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Record, Result


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
