"""Charts of targets: errors before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.compensate.tables import measured_targets
from cellapp.commands.compensate.words import Measured
from cellapp.commands.view.charts import STAGE_STYLES, Axis, Chart, drawable_mm, noise_limit, series
from cellapp.ground.counting import counted, mm

_BEFORE, _AFTER = STAGE_STYLES["nominal"], STAGE_STYLES["effects"]
_CORRECTED, _OUT = STAGE_STYLES["network"], 5
_NOT_YET = "No target was measured with both commands yet: push with verification first."


def target_charts(verify: VerifyResult | None, floors_mm: Mapping[str, float | None]) -> list[Chart]:
    """Show the error at each target with and without compensation, a chart for each arm, in the order of the tables.

    Cooperative targets, if there are any, have one of the distance between both SMRs. ``floors_mm`` is the noise floor
    of each arm of the cell.
    """
    charts = []
    for name, floor_mm in floors_mm.items():
        measured = [] if verify is None else measured_targets(verify, name)
        charts.append(_errors(f"Arm {name}: targets", "measured error", measured, floor_mm))
    if verify is not None and verify.pairs:
        pairs = [pair for pair in verify.pairs if pair.nominal_mm is not None and pair.compensated_mm is not None]
        charts.append(_errors("Cooperative targets", "error of the distance", pairs, None))
    return charts


def _errors(title: str, label: str, measured: Sequence[Measured], floor_mm: float | None) -> Chart:
    """Show errors without and with compensation, and after corrections; mark those out of tolerance."""
    x, y = Axis("target"), Axis(label, "mm", logarithmic=True)
    if not measured:
        return Chart(title, x, y, (), _NOT_YET)
    number = np.arange(1.0, len(measured) + 1.0)
    before = np.array([one.nominal_mm for one in measured], dtype=np.float64)
    after = np.array([one.compensated_mm for one in measured], dtype=np.float64)
    last = np.array([one.final_mm for one in measured], dtype=np.float64)
    drawn = [
        series("uncompensated", number, drawable_mm(before), "points", style=_BEFORE),
        series("compensated", number, drawable_mm(after), "points", style=_AFTER, mark="■"),
    ]
    corrected = np.array([len(one.rounds_mm) > 1 for one in measured])
    if corrected.any():
        drawn.append(series("corrected", number[corrected], drawable_mm(last[corrected]), "points", style=_CORRECTED))
    out = np.array([one.verdict == "out" for one in measured])
    if out.any():
        drawn.append(series("out of tolerance", number[out], drawable_mm(last[out]), "points", style=_OUT, mark="X"))
    better = int(np.sum(last < before))
    by_measuring = f", {mm(float(last.mean()))} corrected by measuring" if corrected.any() else ""
    message = (
        f"Mean error at {counted(len(measured), 'target')}: {mm(float(before.mean()))} uncompensated,"
        f" {mm(float(after.mean()))}"
        f" compensated{by_measuring}; {'all' if better == len(measured) else better} became better."
    )
    return Chart(title, x, y, tuple(drawn), message, noise_limit(floor_mm), by_stage=True)
