"""Results of ``compensate`` and ``push``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.results.base import ErrorSummary, Record, Result


class TargetCommand(Record):
    """Joint positions [rad] for one target with the nominal and with the calibrated model, or why there are none."""

    name: str
    arm: str
    refusal: str
    q_nominal: tuple[float, ...] | None
    q_compensated: tuple[float, ...] | None


class CompensateResult(Result):
    """``compensate``: a command for each target; ``notes`` say where the model that was used is out of date."""

    schema_: Literal["cellapp-compensate"] = "cellapp-compensate"
    version: Literal[1] = 1
    targets: tuple[TargetCommand, ...]
    notes: tuple[str, ...] = ()


class MeasuredTarget(Record):
    """Distance of the measured SMR from one target with either command [mm]; None where it was not measured."""

    name: str
    arm: str
    nominal_mm: float | None
    compensated_mm: float | None
    note: str


class ArmVerification(Record):
    """Distances from the targets of one arm with nominal and with compensated commands."""

    nominal_mm: ErrorSummary
    compensated_mm: ErrorSummary


class VerifyResult(Result):
    """``push``: every target, and with ``--verify`` the errors of each arm before and after compensation.

    ``notes`` also say where the model that was used was out of date.
    """

    schema_: Literal["cellapp-verify"] = "cellapp-verify"
    version: Literal[1] = 1
    arms: Mapping[str, ArmVerification]
    targets: tuple[MeasuredTarget, ...]
    notes: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Why the verification did not hold, arm by arm; empty if it did."""
        found = []
        for name in dict.fromkeys(target.arm for target in self.targets):
            arm = self.arms.get(name)
            if arm is None:
                found.append(f"arm {name}: no target could be measured")
            elif arm.compensated_mm.mean >= arm.nominal_mm.mean:
                found.append(
                    f"arm {name}: the mean error at compensated targets is {arm.compensated_mm.mean:.3f} mm,"
                    f" at uncompensated ones {arm.nominal_mm.mean:.3f} mm; do not use this calibration"
                )
        return found
