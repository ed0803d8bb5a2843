"""A designed plan's result as the product makes it, with round numbers; for what is drawn and said of it."""

from __future__ import annotations

from typing import Literal

from cellapp.cell.planning.records import (
    ArmDesign,
    FactorCorrelation,
    ObservabilityIndices,
    PlanDesignResult,
    PlanQuality,
    TravelTime,
)


def quality(stops: int, parameters: float = 1.0, error_mm: float = 0.01) -> PlanQuality:
    indices = ObservabilityIndices(o1=0.4, o2=0.02, o3=0.3, o4=0.006, o5=0.05)
    return PlanQuality(stops=stops, parameters=parameters, mean_mm=error_mm, worst_mm=3.0 * error_mm, indices=indices)


def arm_design(stops: int = 400) -> ArmDesign:
    equal: dict[Literal["parameters", "mean", "worst"], float] = {"parameters": 2.1, "mean": 1.6, "worst": 3.2}
    return ArmDesign(
        candidates=20_000,
        drawn=600_000,
        rejected={"outside the tracker's view": 400_000, "collides": 180_000},
        designed=quality(stops, 0.7, 0.007),
        random=quality(stops),
        equal_to_random={what: factor * stops for what, factor in equal.items()},
        by_stops=tuple(
            quality(n, 0.7, 0.007 * (stops / n) ** 0.5) for n in (stops // 8, stops // 4, stops // 2, stops)
        ),
        largest_gap=(0.2, 0.1, 0.1, 0.3, 0.2, 0.4),
    )


def correlation(size: float, factor: str, other: str, *, chosen: bool = True) -> FactorCorrelation:
    return FactorCorrelation(arm="left", factor=factor, other=other, correlation=size, can_be_chosen=chosen)


def plan_design(stops: int = 400, arms: tuple[str, ...] = ("left", "right")) -> PlanDesignResult:
    return PlanDesignResult(
        arms={name: arm_design(stops) for name in arms},
        correlations=(
            correlation(0.04, "approach side of joint 2 of left", "time"),
            correlation(-0.08, "step of joint 3 of left", "dwell"),
            correlation(0.35, "q2 of left", "q3 of right", chosen=False),
        ),
        travel=TravelTime(planned_s=1800.0, random_order_s=3000.0),
        detours=7,
        blocks=8,
        repeats=10,
        notes=("joint 6 was not asked for phase coverage",),
    )
