"""Drawn records of runs: estimates with known errors about a known truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.estimation.discovery.records import Place
from cellapp.estimation.monitoring.fleet.record import ArmRecord, EffectRecord, GeometryRecord, RunRecord
from cellapp.estimation.monitoring.fleet.records import DatedValue, Figure
from cellapp.ground.results import Estimate

NAMES = ("x0", "theta1", "theta2", "d2", "d3", "a3", "tx")
SIGMA = np.array([20e-6, 1e-3, 5e-6, 300e-6, 300e-6, 3e-6, 10e-6])
"""Standard deviations of the estimates: theta1 and d3 are merged into x0 and d2."""


def geometry(
    rng: np.random.Generator, truth: Mapping[str, float] | None = None, scatter: float = 1.0
) -> GeometryRecord:
    """Estimates about a truth; d2 and d3 act alike, so that only their sum is known, to 2 um."""
    k = len(NAMES)
    covariance = np.diag(SIGMA**2)
    a, b = NAMES.index("d2"), NAMES.index("d3")
    covariance[a, b] = covariance[b, a] = 0.5 * (2e-6) ** 2 - SIGMA[a] ** 2
    noise = rng.multivariate_normal(np.zeros(k), covariance, method="cholesky")
    true = np.array([(truth or {}).get(name, 0.0) for name in NAMES])
    return GeometryRecord(
        values=dict(zip(NAMES, (true + scatter * noise).tolist(), strict=True)),
        nominal=dict.fromkeys(NAMES, 0.0),
        covariance=tuple(covariance[np.tril_indices(k)].tolist()),
        merged={"d3": {"d2": 1.0}, "theta1": {}},
        determined=("x0", "theta2", "d2", "a3", "tx"),
        levers={name: 0.5 if name.startswith("theta") else 1.0 for name in NAMES},
        degrees_of_freedom=250,
    )


def effect(
    slug: str, values: Mapping[str, float], error: float = 1e-6, *, size_mm: float = 0.05, instead: Sequence[str] = ()
) -> EffectRecord:
    """An effect of joints 1 and 2."""
    return EffectRecord(
        effect=slug,
        title=slug,
        where=Place(joints=(1, 2), acts_on=("joint 1", "joint 2")),
        parameters={name: Estimate(value=v, standard_error=error, unit="rad") for name, v in values.items()},
        size_mm=size_mm,
        n=40,
        answer_set=(slug, *instead),
    )


def arm(
    shape: GeometryRecord | None,
    *,
    key: str = "S-1",
    effects: tuple[EffectRecord, ...] | None = None,
    smallest: Mapping[str, Mapping[str, float]] | None = None,
    unseen: tuple[str, ...] = (),
    figures: Mapping[Figure, tuple[DatedValue, ...]] | None = None,
) -> ArmRecord:
    """An arm that was searched if it has ``effects``."""
    return ArmRecord(
        type="UR10",
        key=key,
        known_by="controller",
        serial=key,
        geometry=shape,
        effects=effects,
        smallest=smallest or {},
        unseen=unseen,
        heldout_rms_mm=0.03,
        heldout_n=40,
        figures=figures or {},
    )


def month(number: int) -> str:
    """A day in a month after January 2026."""
    return f"{2026 + number // 12}-{number % 12 + 1:02}-05T08:00:00+00:00"


def run(number: int, arms: Mapping[str, ArmRecord], *, tolerance_mm: float | None = None) -> RunRecord:
    """The run of a month."""
    return RunRecord(
        run=f"logs/{number:02}",
        profile="cell",
        began=month(number),
        stage="discover",
        arms=arms,
        tolerance_mm=tolerance_mm,
    )
