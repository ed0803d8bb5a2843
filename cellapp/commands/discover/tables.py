"""Tables of a discovery, for terminal, TUI and page."""

from __future__ import annotations

import math
from operator import itemgetter

from cellapp.commands.view.table import Cell, Interval, Table, table_of, table_of_cells, with_rows, without_empty
from cellapp.commands.view.words import interval_95, law_words, place_words, probability_words, short_reason
from cellapp.estimation.discovery.records import AcceptedEffect, ArmDiscoveryResult, CycleBand
from cellapp.ground.results import Estimate

_MM = ".4f"
_SAME = 0.005
"""If the last step is within this relative difference of the final error, the final model gets no row of its own."""


_SIZE_COLUMNS = (
    "where",
    "parameter",
    ("value", ".3f"),
    ("95 % interval", ".3f"),
    "unit",
    ("moves the SMR", _MM, "mm rms"),
)


def gap_steps(arm: ArmDiscoveryResult) -> list[tuple[str, float]]:
    """Return the steps of the search and the held-out rms error [mm] after each; the last is the final model."""
    steps = [(step.what, step.heldout_mm) for step in arm.steps]
    after = arm.heldout_mm.after
    if not steps or abs(steps[-1][1] - after) > _SAME * after:
        steps.append(("final model", after))
    return steps


def noise_floor(arm: ArmDiscoveryResult) -> float | None:
    """Return the noise floor [mm], stated or else estimated; None if neither is known."""
    floor = arm.noise_floor_mm
    if floor is not None and math.isfinite(floor):
        return floor
    return None if arm.noise_mm is None else arm.noise_mm.rms


def noise_floor_words(arm: ArmDiscoveryResult) -> str:
    """Return ``noise floor``; ``estimated noise floor`` if the readings state no uncertainty."""
    estimated = arm.noise_mm is not None and arm.noise_mm.source == "estimated"
    return "estimated noise floor" if estimated else "noise floor"


def _motion_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show effects in recordings of motion beside the accepted ones."""
    accepted = {one.effect for one in arm.accepted}
    rows = (
        (found.effect, parameter, *interval_95(estimate))
        for found in (() if arm.motion is None else arm.motion.effects)
        if found.effect not in accepted
        for parameter, estimate in found.parameters.items()
    )
    title = f"Arm {name}: what its recordings of motion show besides"
    return without_empty(table_of_cells(title, rows, "effect", *_SIZE_COLUMNS[1:5]))


def numbered_steps_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show the held-out error after each step, numbered as in the chart, and the noise floor."""
    floor = noise_floor(arm)
    rows = [(str(number), what, gap) for number, (what, gap) in enumerate(gap_steps(arm))]
    return table_of(
        f"Arm {name}: held-out error after each step",
        rows if floor is None else [*rows, ("", noise_floor_words(arm), floor)],
        ("step", itemgetter(0)),
        ("what was done", itemgetter(1)),
        ("held-out rms", itemgetter(2), _MM, "mm"),
    )


def accepted_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show accepted effects by their names in the handbook, with their probability and the error they explain."""
    return table_of(
        f"Arm {name}: accepted effects, held-out rms [mm]",
        arm.accepted,
        ("accepted", "effect"),
        ("where", lambda found: place_words(found.where)),
        ("probability", lambda found: probability_words(found.posterior), ""),
        ("corrected p", "evidence.corrected_p", ".2g"),
        ("without", "evidence.heldout_mm.before", _MM),
        ("with", "evidence.heldout_mm.after", _MM),
    )


def evidence_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show the further evidence of accepted effects."""
    return table_of(
        f"Arm {name}: laws and evidence of the accepted effects",
        arm.accepted,
        ("effect", "title"),
        ("law", lambda found: law_words(found.effect, found.law, found.where.joints)),
        ("score", "evidence.statistic", ".1f"),
    )


def size_tables(name: str, arm: ArmDiscoveryResult) -> list[Table]:
    """Show parameters with 95 % intervals, a table for each effect, largest SMR displacement first; then effects in
    motion.

    Free curves and data-driven terms have too many coefficients for a table: it has their size, figures show the rest.
    """
    tables = []
    for one in sorted(arm.accepted, key=lambda one: one.movements[0].moves_mm if one.movements else 0.0, reverse=True):
        order = "the largest first" if one.movements is None else "what moves the SMR most first"
        title = f"Arm {name}: size of {one.effect}, {order}"
        tables.append(without_empty(table_of_cells(title, _size_rows(one), *_SIZE_COLUMNS)))
    return with_rows(*tables, _motion_table(name, arm))


def _size_rows(found: AcceptedEffect) -> list[tuple[Cell, ...]]:
    moves = {place.where: place.moves_mm for place in found.movements or ()}
    if found.description is not None:
        described = found.description
        return [(described.channel, "rms at the SMR", described.size_um, None, "µm", None)]
    if found.law.name == "curve":
        bands = {f"joint {joint}": band for joint, band in (found.cycles or {}).items()}
        ordered = sorted(bands, key=lambda where: -moves.get(where, bands[where].rms_urad))
        return [_curve_row(where, bands[where], moves.get(where)) for where in ordered]
    where_of = {parameter: place.where for place in found.movements or () for parameter in place.parameters}
    ordered = list(where_of) or sorted(found.parameters, key=lambda key: -abs(found.parameters[key].value))
    rows: list[tuple[Cell, ...]] = []
    for parameter in ordered:
        value, interval, unit = interval_95(found.parameters[parameter])
        where = where_of.get(parameter, "")
        rows.append((where, parameter, value, interval, unit, moves.get(where)))
    return rows


def _curve_row(where: str, band: CycleBand, moves_mm: float | None) -> tuple[Cell, ...]:
    error = band.rms_standard_error_urad
    rms = Estimate(value=1e-6 * band.rms_urad, standard_error=None if error is None else 1e-6 * error, unit="rad")
    value, interval, unit = interval_95(rms)
    return (where, "rms over a revolution", value, interval, unit, moves_mm)


def cycle_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show the dominant cycles per revolution of each joint's periodic error."""
    return table_of(
        f"Arm {name}: periodic error by cycles per revolution",
        [(joint, band) for found in arm.accepted for joint, band in (found.cycles or {}).items()],
        ("joint", lambda row: row[0]),
        ("cycles per revolution, middle 80 % of the power", lambda row: _range_of(row[1]), "d"),
        ("strongest", lambda row: row[1].peak, "d"),
        ("rms over a revolution", lambda row: row[1].rms_urad, ".0f", "µrad"),
    )


def _range_of(band: CycleBand) -> Cell:
    return band.first if band.first == band.last else Interval(band.first, band.last)


def candidates_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show the posterior probability of every tested effect, the most probable first."""
    accepted = {found.effect for found in arm.accepted}
    return table_of(
        f"Arm {name}: probability of each effect that was tested",
        sorted(arm.candidates.items(), key=lambda entry: -entry[1]),
        ("effect", lambda row: row[0]),
        ("probability", lambda row: probability_words(row[1]), ""),
        ("in the model", lambda row: "yes" if row[0] in accepted else "no"),
    )


def invisible_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show effects that these data cannot show, with the reason."""
    return table_of(
        f"Arm {name}: effects that these data cannot show",
        arm.invisible,
        ("effect", "effect"),
        ("why it cannot be seen", lambda entry: short_reason(entry.reason)),
        ("visible from", "smallest_seen_rms_mm", _MM, "mm rms"),
    )


def not_found_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Show effects that were not found, with the smallest size that would have been found."""
    return table_of(
        f"Arm {name}: searched for and not found",
        arm.not_found,
        ("effect", "effect"),
        ("would have been seen from", "smallest_seen_rms_mm", _MM, "mm rms"),
        ("visible beside the geometry", "visible_share", ".0f", "%"),
    )
