"""Planned sweeps as tables and sentences: how many, and their forecast beside that of the stops."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.driving.records import SweepCount
from cellapp.cell.planning.records import LawInMotion, SweepForecast
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.commands.view.words import display_unit, geometry_unit
from cellapp.ground.counting import counted
from cellapp.robot.effects import EFFECTS

_SOURCES = ("stops", "sweeps", "both")
_RESTS_ON = (
    "Expected of sweeps: a point of each half second counts as one at rest, as recordings of the twin have it, with the"
    " scatter that arms have before discovery. An effect is seen in a joint from 3.5 standard errors on."
)


def sweep_sentences(sweeps: Mapping[str, SweepCount] | None) -> list[str]:
    """Say how many sweeps each arm makes, how long they last, and what their forecast rests on."""
    if not sweeps:
        return []
    told = [
        f"arm {name}: {counted(its.n, 'sweep')} about its stops, {its.seconds / 60.0:.1f} min"
        + (f"; the other arm swings beside {its.swinging} of them" if its.swinging else "")
        for name, its in sweeps.items()
    ]
    return [*told, _RESTS_ON] if any(its.forecast for its in sweeps.values()) else told


def sweep_tables(sweeps: Mapping[str, SweepCount] | None) -> list[Table]:
    """Show each arm's expected standard errors and smallest visible effects, by stops, sweeps and both."""
    foreseen = {name: its.forecast for name, its in (sweeps or {}).items() if its.forecast is not None}
    return [table for name, one in foreseen.items() for table in (_errors_table(name, one), _laws_table(name, one))]


def _errors_table(name: str, forecast: SweepForecast) -> Table:
    """Show standard errors of predicted positions and of parameters."""
    found = [forecast.accuracy[source] for source in _SOURCES]
    rows: list[tuple[Cell, ...]] = [
        ("predicted position, rms", *(one.standard_error_mm for one in found), "mm"),
        ("predicted position, largest", *(one.largest_mm for one in found), "mm"),
    ]
    for parameter in dict.fromkeys(key for one in found for key in one.parameters):
        its = [one.parameters.get(parameter) for one in found]
        factor, unit = geometry_unit(next(one.unit for one in its if one is not None))
        errors = [None if one is None or one.standard_error is None else factor * one.standard_error for one in its]
        rows.append((parameter, *errors, unit))
    columns = (Column("standard error of"), *(number_column(source, ".4f") for source in _SOURCES), Column("unit"))
    return Table(f"Arm {name}: expected standard errors of stops and sweeps", columns, tuple(rows))


def _laws_table(name: str, forecast: SweepForecast) -> Table:
    """Show from which size on each effect is seen: in the joint that shows it best, and in every joint."""
    columns = (
        Column("effect"),
        *(number_column(f"{source}, {which}", ".3g") for source in _SOURCES for which in ("best joint", "every joint")),
        Column("unit"),
    )
    rows = [_law_row(law) for law in forecast.laws]
    return Table(f"Arm {name}: smallest effects of joints that stops and sweeps show", columns, tuple(rows))


def _law_row(law: LawInMotion) -> tuple[Cell, ...]:
    title = EFFECTS[law.effect].title if law.effect in EFFECTS else law.effect.replace("_", " ")
    title += f", {counted(law.cycles, 'cycle')} a turn" if law.cycles else ""
    factor, unit = display_unit(law.unit)
    cells: list[Cell] = []
    for source in _SOURCES:
        sizes = list(law.smallest[source].values())
        seen = [size for size in sizes if size is not None]
        cells.append(factor * min(seen) if seen else None)
        cells.append(factor * max(seen) if len(seen) == len(sizes) else None)
    return (title, *cells, unit)
