"""The kind ``simulated``: an arm of the simulated cell."""

from __future__ import annotations

from typing import ClassVar, Literal

from drivers.arms.protocol import Arm
from drivers.arms.settings import ArmContext, ArmSettings, EmulatedController
from drivers.findings import Finding
from drivers.settings import simulated_cell


class SimulatedArmSettings(ArmSettings):
    """An arm of the simulated cell."""

    kind: Literal["simulated"] = "simulated"
    needs_plant: ClassVar[bool] = True

    def emulated_controller(self) -> EmulatedController:
        """Return that a controller at any free address can replace it."""
        return EmulatedController()

    def open(self, arm: ArmContext) -> Arm:
        """Return the arm of the plant."""
        from drivers.arms.simulated import SimulatedArm

        return SimulatedArm(simulated_cell(arm.plant), arm.name)

    def probe(self, arm: ArmContext, patience_s: float) -> list[Finding]:
        """Report that there is nothing to check."""
        return [Finding("", "ok", f"simulated {arm.model}; no hardware is touched")]
