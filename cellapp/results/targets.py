"""Results of ``compensate`` and ``push``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.results.base import ErrorSummary, Record, Result

ToleranceVerdict = Literal["in", "out", "cannot say", ""]
"""Whether a target is met to its tolerance; empty where it has none, or where there is nothing to judge."""
_MOST_NAMED = 5
"""Targets that a complaint names; further ones are counted."""


class TargetRecord(Record):
    """The target that a result is about: SMR position [m] and roll, pitch, yaw [rad] in the arm's base frame.

    Position and rotation are None in results of earlier versions.
    """

    name: str
    arm: str
    position: tuple[float, float, float] | None = None
    rpy: tuple[float, float, float] | None = None
    tolerance_mm: float | None = None


class TargetCommand(TargetRecord):
    """Joint positions [rad] for one target with the nominal and with the calibrated model, or why there are none.

    ``uncertainty_mm`` is the model's standard uncertainty of a coordinate of the SMR at the compensated command, None
    where the model states none; ``verdict`` is the prediction made from it.
    """

    refusal: str
    q_nominal: tuple[float, ...] | None
    q_compensated: tuple[float, ...] | None
    uncertainty_mm: float | None = None
    verdict: ToleranceVerdict = ""


class CompensateResult(Result):
    """``compensate``: a command for each target; ``notes`` say where the model that was used is out of date."""

    schema_: Literal["cellapp-compensate"] = "cellapp-compensate"
    version: Literal[1] = 1
    targets: tuple[TargetCommand, ...]
    notes: tuple[str, ...] = ()


class MeasuredTarget(TargetRecord):
    """Distance of the measured SMR from one target with either command [mm]; None where it was not measured.

    ``verdict`` judges the distance with the compensated command: "in", "out" or empty.
    """

    nominal_mm: float | None
    compensated_mm: float | None
    note: str
    verdict: ToleranceVerdict = ""


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
        """Why the verification did not hold: arms that became no better, targets out of tolerance; empty if it did."""
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
        return found + self._out_of_tolerance()

    def _out_of_tolerance(self) -> list[str]:
        out = [target for target in self.targets if target.verdict == "out"]
        if not out:
            return []
        named = [
            f"{target.name} ({target.compensated_mm:.3f} mm, tolerance {target.tolerance_mm:g} mm)"
            for target in out[:_MOST_NAMED]
        ]
        more = [f"{len(out) - _MOST_NAMED} more"] if len(out) > _MOST_NAMED else []
        judged = sum(target.verdict != "" for target in self.targets)
        return [f"{len(out)} of {judged} targets with a tolerance are out of it: {', '.join(named + more)}"]
