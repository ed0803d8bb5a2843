"""Charts of targets: errors before and after, whether stated bounds hold, sources of the uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.compensate.tables import measured_targets
from cellapp.commands.compensate.words import Measured, bounds_and_errors, promise_words
from cellapp.commands.view.charts import STAGE_STYLES, Axis, Chart, drawable_mm, noise_limit, series
from cellapp.ground.counting import counted, mm

_BEFORE, _AFTER = STAGE_STYLES["nominal"], STAGE_STYLES["effects"]
_CORRECTED, _OUT = STAGE_STYLES["network"], 5
_NOT_YET = "No target was measured with both commands yet: push with verification first."


def target_charts(verify: VerifyResult | None, floors_mm: Mapping[str, float | None]) -> list[Chart]:
    """Show all charts of measured targets; ``floors_mm`` is the noise floor of each arm of the cell.

    Always the errors of each arm; cooperative targets and bounds only if there are any.
    """
    charts = [target_chart(name, verify, floor) for name, floor in floors_mm.items()]
    if verify is None:
        return charts
    if verify.pairs:
        charts.append(pair_chart(verify))
    if bounds_and_errors(verify):
        charts.append(bound_chart(verify))
    return charts


def target_chart(name: str, verify: VerifyResult | None, floor_mm: float | None) -> Chart:
    """Show the measured error at each target of one arm without and with compensation, in the order of the table."""
    measured = [] if verify is None else measured_targets(verify, name)
    return _errors(f"Arm {name}: targets", "measured error", measured, floor_mm)


def pair_chart(verify: VerifyResult) -> Chart:
    """Show the error of the distance between both SMRs at each cooperative target, in the order of the table."""
    measured = [pair for pair in verify.pairs if pair.nominal_mm is not None and pair.compensated_mm is not None]
    return _errors("Cooperative targets", "error of the distance", measured, None)


def bound_chart(verify: VerifyResult) -> Chart:
    """Show the measured error by the model alone over its stated 95 % bound; below the line the bound holds."""
    title, x, y = "Stated bounds", Axis("predicted 95 % bound", "mm", True), Axis("measured error", "mm", True)
    known = {name: bounds_and_errors(verify, name) for name in verify.arms}
    drawn = []
    for style, (name, its) in enumerate(known.items()):
        if its:
            bound, error = np.array(its).T
            drawn.append(series(f"arm {name}", drawable_mm(bound), drawable_mm(error), "points", style=style))
    if not drawn:
        return Chart(title, x, y, (), "No measured target has a predicted bound.")
    ends = np.concatenate([values for one in drawn for values in (one.x, one.y)])  # bounds alone span too small a range
    diagonal = np.array([ends.min(), ends.max()])
    drawn.append(series("error = bound", diagonal, diagonal, "line", style=len(STAGE_STYLES) + 1, mark=":"))
    message = f"{promise_words(verify)[0].capitalize()}: 95 % are to be expected."
    return Chart(title, x, y, tuple(drawn), message)


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
