"""The certificate of a run as tables and sentences, for terminal, TUI, page and print."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.certificate.request import CertificateRequest
from cellapp.commands.certificate_result import CertificateResult, CertifiedArm, CertifiedCharacteristic, CertifiedTests
from cellapp.commands.record import View
from cellapp.commands.view.parts import Facts, Section
from cellapp.commands.view.table import Cell, Field, Table, table_of, table_of_cells, with_rows
from cellapp.commands.view.words import CHARACTERISTIC_WORDS, RULE_WORDS, Verdict, judgement_table, verdict_of
from cellapp.estimation.iso9283.coverage import not_done
from cellapp.estimation.iso9283.norm import ISO_COMMANDS
from cellapp.estimation.uncertainty.budget import COVERAGE, Range, combined
from cellapp.estimation.uncertainty.records import AngleContribution, UncertaintyContribution
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.results import ErrorSummary, day_of, minute_of

NOT_GIVEN = "not given"
_COMPLETE = "Every entry of this certificate that a person gives was given."
_TRACEABLE = (
    "Traceability is as the instruments' own calibration certificates state it; this program does not verify those."
)
_COPIES = (
    "This certificate may be copied as a whole only; extracts need the written permission of the organisation that"
    " issued it."
)
_FOUND_AND_LEFT = (
    "As found: commands of the published geometry. As left: compensated commands. Errors in mm at targets that were"
    " driven and measured; predicted ones are of models at stops that the calibration did not use."
)
_UNCERTAINTY = (
    "By JCGM 100 (GUM): independent contributions of one coordinate in its worst direction; type A from the readings, B"
    " as stated. Of distances between two positions each contribution counts twice, of distances between two arms those"
    " of both arms. A contribution that is not given leaves the uncertainty unknown."
)
_ERROR_COLUMNS = (
    "error",
    "from",
    ("as found: mean", ".3f"),
    ("largest", ".3f"),
    ("as left: mean", ".3f"),
    ("95 %", ".3f"),
    ("largest", ".3f"),
    ("n", "d"),
)
_ANGLES: tuple[Field, ...] = (("rotation as found [mrad]", "found_mrad", ".3f"), ("as left [mrad]", "left_mrad", ".3f"))
_NOWHERE = (None, None, None)
"""Coordinates of a target whose position was not stored."""


def view(result: CertificateResult, request: CertificateRequest | None = None) -> View:
    """Show what is certified and where it was written; ``strict`` fails on all that does not confirm conformity."""
    written = [] if request is None else [f"written: {request.out or request.folder}"]
    strict = request is not None and request.strict
    complaint = "; it does not confirm conformity" if result.complaints() else ""
    return View(
        (*certificate_tables(result), *certificate_sentences(result), *written),
        result.complaints() if strict else (),
        held=f"certificate {result.number} was written{complaint}",
    )


def certificate_tables(result: CertificateResult) -> list[Table]:
    """Show errors as found and as left, judgements, uncertainty budgets, instruments."""
    judged = [judgement_table(result.judgements)] if result.judgements else []
    tested = [iso_table(result.iso9283)] if result.iso9283 is not None else []
    return [*errors_tables(result), *judged, *tested, *budget_tables(result), instruments_table(result)]


def certificate_sentences(result: CertificateResult) -> list[str]:
    """State verdict, marks, limits, what is not given, and where the certificate was written."""
    verdict = certificate_verdict(result)
    written = [f"certificate {result.number}: {', '.join(result.files)}"] if result.files else []
    return [
        *(f"MARK: {mark}" for mark in certificate_marks(result)),
        f"{verdict.title}: {verdict.sentence}" if verdict.sentence else verdict.title,
        *result.limits,
        *([f"not given: {'; '.join(result.missing)}"] if result.missing else []),
        *written,
    ]


def certificate_verdict(result: CertificateResult) -> Verdict:
    """Summarize all judgements of a certificate in a title and a sentence."""
    if result.judgements:
        return verdict_of(result.judgements)
    return Verdict(None, "Not judged", "No tolerance is given: the figures stand without a verdict.")


def certificate_marks(result: CertificateResult, outdated: str = "") -> list[str]:
    """Return the marks that a reader must see first; ``outdated`` says why the certificate no longer holds."""
    return [
        *([f"this certificate is out of date: {outdated}"] if outdated else []),
        *result.warnings,
        *(f"out of date when it was issued: {one}" for one in result.out_of_date),
    ]


def certificate_sections(result: CertificateResult) -> list[Section]:
    """Show the certificate as printed, from its judgements to the hashes of its basis."""
    objects = Facts(tuple((f"Arm {name}", _arm_words(arm)) for name, arm in result.arms.items()))
    errors, *rotations = errors_tables(result)
    position_budget, *rotation_budget = budget_tables(result)
    return [
        *([_of_table(judgement_table(result.judgements))] if result.judgements else []),
        _of_table(errors, _FOUND_AND_LEFT),
        *map(_of_table, rotations),
        *([_of_table(targets_table(result))] if result.targets else []),
        *([] if result.iso9283 is None else [_of_table(iso_table(result.iso9283), iso_sentence(result.iso9283))]),
        Section([objects, Facts(tuple(_facts(result)))], title="Object and conditions"),
        _of_table(instruments_table(result)),
        _of_table(position_budget, _UNCERTAINTY),
        *map(_of_table, rotation_budget),
        Section(_statements(result), title="Statements"),
        *([Section([Facts(tuple(result.rests_on.items()))], title="Data (SHA-256)")] if result.rests_on else []),
    ]


def _of_table(table: Table, about: str = "") -> Section:
    return Section([table], about=about, title=table.title)


def _statements(result: CertificateResult) -> list[str]:
    """State what is not in figures: method, rule, limits, what is not given, copies."""
    rule = RULE_WORDS[result.judgements[0].rule] if result.judgements else ""
    missing = f"Not given: {'; '.join(result.missing)}." if result.missing else _COMPLETE
    return [
        *([f"Method: {result.method}"] if result.method else []),
        *([f"Decision rule: {rule[0].lower()}{rule[1:]}"] if rule else []),
        *result.limits,
        missing,
        _TRACEABLE,
        _COPIES,
    ]


def targets_table(result: CertificateResult) -> Table:
    """Show every verified target: position in the tracker frame, error as found and as left [mm]."""
    return table_of(
        "Verified targets [mm]",
        result.targets,
        ("target", "name"),
        ("arm", "arm"),
        *(
            (f"{axis} (tracker)", lambda one, place=place: (one.wanted_M_mm or _NOWHERE)[place], ".1f")
            for place, axis in enumerate("xyz")
        ),
        ("as found", "found_mm", ".3f"),
        ("as left", "left_mm", ".3f"),
        *(_ANGLES if any(one.left_mrad is not None for one in result.targets) else ()),
    )


def errors_tables(result: CertificateResult) -> list[Table]:
    """Show errors as found and as left: measured at targets, if any, and predicted at held-out stops.

    Of positions [mm]; of rotations [mrad] where a probe measured them.
    """
    positions, rotations = list[tuple[Cell, ...]](), list[tuple[Cell, ...]]()
    for name, arm in result.arms.items():
        positions += _error_rows(f"Arm {name}, position", arm.errors.positions)
        rotations += _error_rows(f"Arm {name}, orientation", arm.errors.orientations)
    positions += _error_rows("Both arms, distance between them", result.pair.positions)
    rotations += _error_rows("Both arms, rotation of one flange in the other's frame", result.pair.orientations)
    title = "Errors as found (published geometry) and as left (compensated) [mm]"
    rotated = table_of_cells("Errors of orientation as found and as left [mrad]", rotations, *_ERROR_COLUMNS)
    return [table_of_cells(title, positions, *_ERROR_COLUMNS), *with_rows(rotated)]


def budget_tables(result: CertificateResult) -> list[Table]:
    """Show standard uncertainties by arm, combined and expanded by the GUM: of positions, and of rotations if any."""
    positions = [(one, one.standard_mm) for one in result.contributions]
    rotations = [(one, one.standard_mrad) for one in result.orientation_contributions or ()]
    return [
        _budget("Uncertainty of a measured position error [mm]", positions),
        *([_budget("Uncertainty of a measured error of orientation [mrad]", rotations)] if rotations else []),
    ]


def iso_table(tests: CertifiedTests) -> Table:
    """Show the characteristics of ISO 9283 [mm], as found and as left, with a column for each arm."""
    values = {(one.where, one.characteristic, one.commands): one for one in tests.characteristics}
    arms = list(dict.fromkeys(one.where for one in tests.characteristics))
    rows = (
        (
            CHARACTERISTIC_WORDS[name],
            *(cell for arm in arms for cell in _iso_cells(*(values.get((arm, name, kind)) for kind in ISO_COMMANDS))),
        )
        for name in dict.fromkeys(one.characteristic for one in tests.characteristics)
    )
    titles = ("as found", "as left", "U (k = 2)", "cycles")
    numbers = ((f"{arm}: {title}", "d" if title == "cycles" else ".3f") for arm in arms for title in titles)
    return table_of_cells("Tests by ISO 9283 [mm]", rows, "characteristic", *numbers)


def iso_sentence(tests: CertifiedTests) -> str:
    """State the conditions of the tests, and what is missing."""
    speed = "" if tests.speed_share is None else f"{tests.speed_share:.0%} of the profile's speed; "
    loads = ", ".join(f"{name} {mass:g} kg" for name, mass in tests.payload_kg.items())
    missing = f" Missing: {'; '.join(tests.missing)}." if tests.missing else ""
    names = dict.fromkeys(name for names in not_done(tests.coverage).values() for name in names)
    left_out = f" Of the norm not done: {', '.join(names)}." if names else ""
    return (
        f"Largest value of all poses, distances or paths. {speed}payload {loads}; U and cycles are those of the errors"
        f" as left, where there are any.{missing}{left_out}"
    )


def instruments_table(result: CertificateResult) -> Table:
    """Show the instruments that were used."""
    fields = ("model", "serial", "calibrated", "due", "certificate")
    return table_of(
        "Instruments",
        result.instruments,
        ("instrument", "role"),
        *((name, lambda one, name=name: getattr(one, name) or NOT_GIVEN) for name in fields),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _error_rows(what: str, errors: Sequence[tuple[ErrorSummary | None, ErrorSummary | None]]) -> list[tuple[Cell, ...]]:
    """Return the rows of measured and of predicted errors, each as found and as left."""
    rows: list[tuple[Cell, ...]] = []
    for source, (found, left) in zip(("verified targets", "predicted, held out"), errors, strict=True):
        if left is not None:
            before = (None, None) if found is None else (found.mean, found.max)
            rows.append((what, source, *before, left.mean, left.p95, left.max, left.n))
    return rows


def _budget(title: str, lines: Sequence[tuple[UncertaintyContribution | AngleContribution, float | None]]) -> Table:
    """Show contributions with their values, a column an arm; the basis is that of the arm with the largest one."""
    arms = dict.fromkeys(one.where for one, _ in lines)
    rows = list[tuple[Cell, ...]]()
    for source, its in grouped((one.source, (one, value)) for one, value in lines).items():
        values = {one.where: _or_unknown(value) for one, value in its}
        largest, _ = max(its, key=lambda line: line[1] or 0.0)
        rows.append((source, *map(values.get, arms), largest.evaluation, largest.basis))
    together = [combined(value for one, value in lines if one.where == arm) for arm in arms]
    rows.append(("combined, u", *map(_or_unknown, together), "", "root of the sum of squares"))
    expanded = (None if value is None else COVERAGE * value for value in together)
    rows.append(("expanded, U", *map(_or_unknown, expanded), "", f"k = {COVERAGE:g}, about 95 %"))
    return table_of_cells(title, rows, "contribution", *((f"arm {arm}", ".4f") for arm in arms), "type", "basis")


def _iso_cells(found: CertifiedCharacteristic | None, left: CertifiedCharacteristic | None) -> tuple[Cell, ...]:
    values = (None if one is None else one.value_mm for one in (found, left))
    last = left or found
    return (*values, None if last is None else last.expanded_mm, None if last is None else last.n)


def _or_unknown(value: float | None) -> Cell:
    return NOT_GIVEN if value is None else value


def _facts(result: CertificateResult) -> list[tuple[str, str]]:
    """Return who, when, where, and under which conditions."""
    return [
        ("Organisation", result.organisation or NOT_GIVEN),
        ("Client", result.client or NOT_GIVEN),
        ("Location", result.location or NOT_GIVEN),
        ("Operator", result.operator or NOT_GIVEN),
        ("Measured", _period(result.measured)),
        *_shared("Payload", "kg", {name: arm.payload_kg for name, arm in result.arms.items()}),
        *_shared("Air temperature", "degC", {name: arm.air_c for name, arm in result.arms.items()}),
        *_shared("Joint temperatures", "degC", {name: arm.joints_c for name, arm in result.arms.items()}),
        ("Air pressure", _stated(result.air_pressure_hpa, "hPa")),
        ("Relative humidity", _stated(result.relative_humidity_percent, "%")),
        *_shared("Distance from tracker", "m", {name: arm.distance_m for name, arm in result.arms.items()}),
        ("Procedure", result.procedure or NOT_GIVEN),
        ("Software", result.program),
    ]


def _arm_words(arm: CertifiedArm) -> str:
    controller = " ".join(filter(None, (arm.controller_model, arm.controller_software)))
    parts = [
        arm.type,
        f"serial {arm.serial or NOT_GIVEN}",
        *([arm.asset] if arm.asset else []),
        f"controller serial {arm.controller_serial or NOT_GIVEN}" + (f" ({controller})" if controller else ""),
        counted(arm.readings, "reading"),
    ]
    return ", ".join(parts)


def _shared(title: str, unit: str, ranges: dict[str, Range | None]) -> list[tuple[str, str]]:
    """Return each arm's range, or one for all if they are the same."""
    words = {name: _stated(one, unit) for name, one in ranges.items()}
    if len(set(words.values())) == 1:
        return [(title, next(iter(words.values())))]
    return [(title, "; ".join(f"{name} {text}" for name, text in words.items()))]


def _stated(limits: Range | None, unit: str) -> str:
    return NOT_GIVEN if limits is None else f"{_span(limits)} {unit}"


def _span(limits: Range) -> str:
    low, high = (f"{value:.2f}".rstrip("0").rstrip(".") for value in limits)
    return low if low == high else f"{low} to {high}"


def _period(measured: Sequence[str]) -> str:
    if not measured:
        return NOT_GIVEN
    first, last = (minute_of(time) for time in (measured[0], measured[-1]))
    if first == last:
        return f"{first} UTC"
    if day_of(first) == day_of(last):
        return f"{first} to {last[11:]} UTC"
    return f"{first} to {last} UTC"
