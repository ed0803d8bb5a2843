"""Errors at the SMR with the published, the controller's own, and the identified D-H rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import recorded_controllers
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.quantities import position_errors
from cellapp.ground.profile import Arm
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.plain_dh import hayati_rows
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import controller_rows, published_rows

_ABOUT = (
    "Rows alone, at configurations that the calibration did not use: base and SMR are registered to the other readings;"
    " no network, no effects."
)


def controllers_section(run: RunFile, data: ReportData) -> Section | None:
    """Show errors at the SMR by published, factory and identified rows; None if no controller has its own."""
    recorded, rows = recorded_controllers(run), list[tuple[Cell, ...]]()
    said = []
    for name, held_out in data.held_out.items():
        arm, controller = run.profile.arms[name], recorded.get(name)
        own = None if controller is None else controller.dh_rows
        factory = np.array(own) if own is not None else None if arm.factory is None else controller_rows(arm)
        if factory is None:
            continue
        learn = data.readings[name].take(data.readings[name].in_split("identify"))
        errors: dict[str, Array] = {}
        for whose, table in (("published", published_rows(arm)), ("factory", factory)):
            computed = _computed(arm, table, learn.q, learn.p_M, held_out.readings.q)
            errors[whose] = position_errors(held_out.readings.p_M, computed) * 1e3
        if "geometry" in held_out.errors_mm:
            errors["cellapp"] = held_out.errors_mm["geometry"]
        for whose, off in errors.items():
            rows.append((name, whose, float(off.mean()), float(np.sqrt(np.mean(off**2))), float(off.max())))
        said.append(f"arm {name}: " + ", ".join(f"{whose} {off.mean():.3f} mm" for whose, off in errors.items()))
    if not rows:
        return None
    columns = (
        Column("arm"),
        Column("rows"),
        *(number_column(f"{what} [mm]", ".4f") for what in ("mean", "rms", "max")),
    )
    return Section(
        "",
        [Table("Errors at the SMR by whose rows", columns, tuple(rows))],
        f"Mean error of the SMR by whose D-H rows: {'; '.join(said)}.",
        _ABOUT,
    )


def _computed(arm: Arm, rows: Array, q: Array, p_M: Array, at: Array) -> Array:
    """Compute SMR positions (m, 3) [m] at ``at`` (m, N) by plain rows (N, 4); base and SMR are registered to the
    readings ``q`` and ``p_M`` (n, 3)."""
    published = published_rows(arm)
    chain = replace(nominal_geometry(published, np.zeros(3)), rows=hayati_rows(rows, published))
    return smr_positions(start_from_nominal(chain, q, p_M, tool_unknown=True), at)
