"""Verifications whose figures are known, for budgets and judgements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cellapp.cell.targets.records import ArmVerification, MeasuredPair, MeasuredTarget, VerifyResult
from cellapp.commands.run_results import RunResults
from cellapp.estimation.iso9283.records import ArmIso9283, CommandedTests, Iso9283Result, IsoValue, PoseCharacteristics
from cellapp.ground.profile import Profile
from cellapp.ground.results import ErrorSummary
from tests.twin import altered, small_twin

DISTANCE_M = 4.0


def profile_with(tolerances: Mapping[str, Any], traceability: Mapping[str, Any] | None = None) -> Profile:
    """The twin with these tolerances [m], and the twin's traceability with some keys changed."""
    twin = small_twin()
    empty = {name: None for name in type(twin.tolerances).model_fields if name not in ("decision", "mpe")}
    return altered(twin, tolerances={**empty, **tolerances}, traceability=traceability or {})


def measured(name: str, arm: str, error_mm: float, across_m: float = 0.0) -> MeasuredTarget:
    """A target at 4 m along x from the tracker, missed along x."""
    wanted = (DISTANCE_M, across_m, 0.0)
    return MeasuredTarget(
        name=name,
        arm=arm,
        nominal_mm=4.0,
        compensated_mm=error_mm,
        note="",
        wanted_M=wanted,
        measured_M=(DISTANCE_M - error_mm * 1e-3, across_m, 0.0),
    )


def pair(name: str, error_mm: float) -> MeasuredPair:
    """A cooperative target of the twin's arms."""
    return MeasuredPair(
        name=name, arms=("left", "right"), wanted_mm=800.0, nominal_mm=3.0, compensated_mm=error_mm, tolerance_mm=None
    )


def verification(
    targets: Sequence[MeasuredTarget], pairs: Sequence[MeasuredPair] = (), stopped: str = ""
) -> VerifyResult:
    """A verification of these targets; its summaries do not matter."""
    some = ErrorSummary(mean=1.0, rms=1.0, std=0.0, max=1.0, n=1)
    arms = {one.arm: ArmVerification(nominal_mm=some, compensated_mm=some) for one in targets}
    return VerifyResult(arms=arms, targets=tuple(targets), pairs=tuple(pairs), stopped=stopped)


def results(**stages: Any) -> RunResults:
    """Results of a run with these stages."""
    return RunResults(run="run", **stages)


def pose_test(cycles: int = 30) -> Iso9283Result:
    """The left arm was tested at one pose: AP 0.08 mm +- 0.01 mm."""
    pose = PoseCharacteristics(
        pose="P1",
        error_mm=(0.08, 0.0, 0.0),
        accuracy=IsoValue(value_mm=0.08, expanded_mm=0.01, n=cycles),
        repeatability=IsoValue(value_mm=0.02, expanded_mm=0.01, n=cycles),
    )
    arm = ArmIso9283(payload_kg=1.0, tests={"calibrated": CommandedTests(pose=(pose,))})
    return Iso9283Result(tests=("pose",), arms={"left": arm})
