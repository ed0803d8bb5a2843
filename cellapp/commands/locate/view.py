"""The result of ``locate`` as a table and sentences."""

from __future__ import annotations

import math

from cellapp.commands.locate.result import LocateResult
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Cell, Table, columns_of


def view(result: LocateResult, request: Request | None = None) -> View:
    """Show every point, the tracker's station, and why it could not be located."""
    return View(
        (*location_tables(result), *location_sentences(result)), result.complaints(), held="the tracker was located"
    )


def location_tables(result: LocateResult) -> list[Table]:
    """Show every measured point with its residual."""
    rows: list[tuple[Cell, ...]] = [
        (point.arm, point.found_off_mm, *point.residual_mm, math.hypot(*point.residual_mm)) for point in result.points
    ]
    columns = columns_of(
        "arm", ("found off", ".1f"), *((f"residual {axis}", ".3f") for axis in "xyz"), ("residual", ".3f")
    )
    return [Table("Station of the tracker: measured points [mm]", columns, tuple(rows))]


def location_sentences(result: LocateResult) -> list[str]:
    """State the tracker's station, its uncertainty, and whether the points are consistent."""
    test = (
        f"residuals {result.rms_mm:.3f} mm rms; chi-squared {result.chi_squared:.1f} of {result.degrees_of_freedom}"
        f" degrees of freedom, probability {result.probability:.2g}"
    )
    if result.verdict != "located":
        return [f"not located: {test}", *result.complaints(), *result.notes]
    place = ", ".join(f"{value:.4f}" for value in result.tracker_pose.position)
    angles = ", ".join(f"{math.degrees(value):.3f}" for value in result.tracker_pose.rpy)
    what = "moved" if result.moved else "not moved beyond the limit of drift: it stands"
    by = f"{result.shift_mm:.2f} mm and {result.turn_deg:.4f} deg from where the readings were taken"
    return [
        f"the tracker was {what} {by}",
        f"it stands at ({place}) m in the cell, roll, pitch, yaw ({angles}) deg",
        f"the station adds {result.uncertainty_mm:.4f} mm of standard uncertainty to a coordinate; {test}",
        *result.notes,
    ]
