"""Tables of a discovery, for terminal, TUI and page."""

from __future__ import annotations

import math

from cellapp.commands.view.table import Cell, Column, Interval, Table, number_column, without_empty
from cellapp.commands.view.words import interval_95, law_words, place_words, probability_words, short_reason
from cellapp.estimation.discovery.records import AcceptedEffect, ArmDiscoveryResult, CycleBand, DiscoverResult
from cellapp.ground.results import Estimate

_MM = ".4f"
_SAME = 0.005
"""A last step within this relative difference of the final error is the final model: no extra row for it."""


_SIZE_COLUMNS = (
    Column("where"),
    Column("parameter"),
    number_column("value", ".3f"),
    number_column("95 % interval", ".3f"),
    Column("unit"),
    number_column("moves the SMR", _MM, "mm rms"),
)


def gap_steps(arm: ArmDiscoveryResult) -> list[tuple[str, float]]:
    """Steps of the search with the held-out rms error [mm] after each; the last is that of the final model."""
    steps = [(step.what, step.heldout_mm) for step in arm.steps]
    after = arm.heldout_mm.after
    if not steps or abs(steps[-1][1] - after) > _SAME * after:
        steps.append(("final model", after))
    return steps


def noise_floor(arm: ArmDiscoveryResult) -> float | None:
    """Noise floor [mm], as stated or else as estimated; None where neither is known."""
    floor = arm.noise_floor_mm
    if floor is not None and math.isfinite(floor):
        return floor
    return None if arm.noise_mm is None else arm.noise_mm.rms


def noise_floor_words(arm: ArmDiscoveryResult) -> str:
    """``noise floor``, with ``estimated`` where the readings state no uncertainty."""
    estimated = arm.noise_mm is not None and arm.noise_mm.source == "estimated"
    return "noise floor, estimated" if estimated else "noise floor"


def discovery_tables(result: DiscoverResult) -> list[Table]:
    """Held-out error after each step of each arm, its accepted effects, and the sizes of each of them."""
    return [
        table
        for name, arm in result.arms.items()
        for table in (numbered_steps_table(name, arm), short_accepted_table(name, arm), *size_tables(name, arm))
        if table is not None
    ]


def _motion_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """What recordings of motion show beside the accepted effects; None without any."""
    accepted = {one.effect for one in arm.accepted}
    rows: list[tuple[Cell, ...]] = []
    for found in () if arm.motion is None else arm.motion.effects:
        for parameter, estimate in () if found.effect in accepted else found.parameters.items():
            rows.append((found.effect, parameter, *interval_95(estimate)))
    if not rows:
        return None
    columns = (Column("effect"), *_SIZE_COLUMNS[1:5])
    return without_empty(Table(f"Arm {name}: what its recordings of motion show besides", columns, tuple(rows)))


def numbered_steps_table(name: str, arm: ArmDiscoveryResult) -> Table:
    """Held-out error after each step, with the step numbers of its chart, and the noise floor."""
    rows: list[tuple[Cell, ...]] = [(str(number), what, gap) for number, (what, gap) in enumerate(gap_steps(arm))]
    floor = noise_floor(arm)
    if floor is not None:
        rows.append(("", noise_floor_words(arm), floor))
    columns = (Column("step"), Column("what was done"), number_column("held-out rms", _MM, "mm"))
    return Table(f"Arm {name}: held-out error after each step", columns, tuple(rows))


def short_accepted_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Accepted effects by their names in the handbook, with their probability and what they explain; None without."""
    if not arm.accepted:
        return None
    columns = (
        Column("accepted"),
        Column("where"),
        number_column("probability", ""),
        number_column("corrected p", ".2g"),
        number_column("without", _MM),
        number_column("with", _MM),
    )
    rows = [
        (
            found.effect,
            place_words(found.where),
            probability_words(found.posterior),
            found.evidence.corrected_p,
            found.evidence.heldout_mm.before,
            found.evidence.heldout_mm.after,
        )
        for found in arm.accepted
    ]
    return Table(f"Arm {name}: accepted effects, held-out rms [mm]", columns, tuple(rows))


def accepted_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Accepted effects with all their evidence; None if there are none."""
    if not arm.accepted:
        return None
    columns = (
        Column("effect"),
        Column("law"),
        Column("where"),
        number_column("probability", ""),
        number_column("score", ".1f"),
        number_column("corrected p", ".2g"),
        number_column("without it", _MM, "mm"),
        number_column("with it", _MM, "mm"),
        number_column("beside its law", ".0f", "%"),
        Column("answer set"),
        Column("most correlated with"),
    )
    rows = [_accepted_row(found) for found in arm.accepted]
    return Table(f"Arm {name}: accepted effects, held-out rms without and with each", columns, tuple(rows))


def _accepted_row(found: AcceptedEffect) -> tuple[Cell, ...]:
    evidence, correlated = found.evidence, found.correlated_with
    return (
        found.title,
        law_words(found.effect, found.law, found.where.joints),
        place_words(found.where),
        probability_words(found.posterior),
        evidence.statistic,
        evidence.corrected_p,
        evidence.heldout_mm.before,
        evidence.heldout_mm.after,
        None if found.law_misfit is None else 100.0 * found.law_misfit,
        " or ".join(found.answer_set),
        None if correlated is None else f"{correlated.parameter} ({correlated.correlation:+.2f})",
    )


def size_tables(name: str, arm: ArmDiscoveryResult) -> list[Table]:
    """Parameters with 95 % intervals, one table for each effect, what moves the SMR most first; then those in motion.

    Free curves and data-driven terms have too many coefficients for a table: it has their size, figures show the rest.
    """
    tables = []
    for one in sorted(arm.accepted, key=lambda one: one.movements[0].moves_mm if one.movements else 0.0, reverse=True):
        order = "the largest first" if one.movements is None else "what moves the SMR most first"
        title = f"Arm {name}: size of {one.effect}, {order}"
        tables.append(without_empty(Table(title, _SIZE_COLUMNS, tuple(_size_rows(one)))))
    if (in_motion := _motion_table(name, arm)) is not None:
        tables.append(in_motion)
    return tables


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
    return (where, "rms over a whole turn", value, interval, unit, moves_mm)


def cycle_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Dominant cycles per revolution of the periodic error of each joint; None if there is no periodic error."""
    rows = [
        (joint, band.first if band.first == band.last else Interval(band.first, band.last), band.peak, band.rms_urad)
        for found in arm.accepted
        for joint, band in (found.cycles or {}).items()
    ]
    if not rows:
        return None
    columns = (
        Column("joint"),
        number_column("cycles per revolution, middle 80 % of the power", "d"),
        number_column("strongest", "d"),
        number_column("rms over a whole turn", ".0f", "µrad"),
    )
    return Table(f"Arm {name}: periodic error by cycles per revolution", columns, tuple(rows))


def candidates_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Posterior probability of every effect that was tested, the most probable first; None if there are none."""
    if not arm.candidates:
        return None
    accepted = {found.effect for found in arm.accepted}
    ordered = sorted(arm.candidates.items(), key=lambda entry: -entry[1])
    rows = [(slug, probability_words(p), "yes" if slug in accepted else "no") for slug, p in ordered]
    columns = (Column("effect"), number_column("probability", ""), Column("in the model"))
    return Table(f"Arm {name}: probability of each effect that was tested", columns, tuple(rows))


def structure_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Tests of what is left for structure; None if there were none."""
    if arm.structure is None or not arm.structure.tests:
        return None
    rows = tuple((test.against, test.p_value) for test in arm.structure.tests)
    columns = (Column("what is left, against"), number_column("p", ".2g"))
    return Table(f"Arm {name}: structure of what is left", columns, rows)


def invisible_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Effects that these data cannot show, with the reason; None if there are none."""
    rows = [(entry.effect, short_reason(entry.reason), entry.smallest_seen_rms_mm) for entry in arm.invisible]
    if not rows:
        return None
    columns = (Column("effect"), Column("why it cannot be seen"), number_column("visible from", _MM, "mm rms"))
    return Table(f"Arm {name}: effects that these data cannot show", columns, tuple(rows))


def not_found_table(name: str, arm: ArmDiscoveryResult) -> Table | None:
    """Effects that were not found, with the smallest size that would have been; None if there are none."""
    rows = [
        (entry.effect, entry.smallest_seen_rms_mm, None if entry.visible_share is None else 100.0 * entry.visible_share)
        for entry in arm.not_found
    ]
    if not rows:
        return None
    columns = (
        Column("effect"),
        number_column("would have been seen from", _MM, "mm rms"),
        number_column("visible beside the geometry", ".0f", "%"),
    )
    return Table(f"Arm {name}: searched for and not found", columns, tuple(rows))
