"""Sentences of a verification beside its tables: distances between arms, and what correcting by measuring gained."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.results import ArmVerification, MeasuredPair, MeasuredTarget, VerifyResult


def verification_lines(result: VerifyResult) -> list[str]:
    """A line for the pairs, one for each arm and for the pairs that were corrected, and why the job was stopped."""
    lines = []
    if result.cooperative is not None:
        nominal, compensated = result.cooperative.nominal_mm, result.cooperative.compensated_mm
        lines.append(
            f"pairs: the distance between both SMRs is off by {nominal.mean:.3f} mm on average uncompensated,"
            f" {compensated.mean:.3f} mm compensated (max {compensated.max:.3f} mm), {compensated.n} pairs"
        )
    for name, arm in result.arms.items():
        lines += _rounds(f"arm {name}", arm, [target for target in result.targets if target.arm == name])
    if result.cooperative is not None:
        lines += _rounds("pairs", result.cooperative, result.pairs)
    return [*lines, result.stopped] if result.stopped else lines


def _rounds(subject: str, errors: ArmVerification, measured: Sequence[MeasuredTarget | MeasuredPair]) -> list[str]:
    """How far the model alone came, and each round; a target that needed no further one keeps its last error."""
    if errors.corrected_mm is None:
        return []
    most = max(len(one.rounds_mm) for one in measured)
    rounds_mm = [one.rounds_mm for one in measured if one.rounds_mm]
    means = [sum(one[min(k, len(one) - 1)] for one in rounds_mm) / len(rounds_mm) for k in range(most)]
    steps = ", ".join(f"{mean:.3f}" for mean in means[1:])
    by = f"; by round {steps} mm" if steps else "; nothing was left to correct"
    return [
        f"{subject}: mean error with the model alone {errors.compensated_mm.mean:.3f} mm, corrected"
        f" {errors.corrected_mm.mean:.3f} mm (max {errors.corrected_mm.max:.3f} mm){by}"
    ]
