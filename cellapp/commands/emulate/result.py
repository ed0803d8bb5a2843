"""Result of ``emulate``."""

from __future__ import annotations

from cellapp.ground.results import Record, Result
from drivers.emulators.ur_controller.personality import STANDARD_PORTS, Personality


class EmulatedArm(Record):
    """An emulated arm: its controller and where that listens.

    ``control_port`` on 127.0.0.1 accepts commands for faults and for the operator's actions; see
    ``drivers/emulators/ur_controller/control.py``.
    """

    arm: str
    controller: Personality
    host: str
    dashboard_port: int = STANDARD_PORTS["dashboard"]
    primary_port: int = STANDARD_PORTS["primary"]
    script_port: int = STANDARD_PORTS["script"]
    rtde_port: int = STANDARD_PORTS["rtde"]
    control_port: int = 0


class EmulatedTracker(Record):
    """Where the tracker of the simulated cell is served over the bridge protocol."""

    host: str
    port: int


class EmulateResult(Result, schema="cellapp-emulate"):
    """``emulate``: what is served; ``pace`` is simulated seconds per real second."""

    pace: float
    arms: tuple[EmulatedArm, ...]
    tracker: EmulatedTracker | None
