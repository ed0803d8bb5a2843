"""The certificate as HTML: a part of the page, and a file of its own that prints on A4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cellapp.commands.certificate.result import CertificateResult, CertifiedArm, Range
from cellapp.commands.certificate.view import (
    NOT_GIVEN,
    budget_table,
    certificate_verdict,
    errors_table,
    instruments_table,
    iso_sentence,
    iso_table,
    statements,
    targets_table,
)
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.acceptance_words import Verdict, judgement_words
from cellapp.commands.view.table import Table
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.ground.counting import counted
from cellapp.ground.results import CERTIFICATE, StageName
from cellapp.ground.times import day_of, minute_of
from cellapp.interfaces.page.templates import template

_STAGE_WORDS: dict[StageName, str] = {"verify": "verification", "iso9283": "test by ISO 9283"}


@dataclass(frozen=True)
class CertificateSection:
    """A certificate in words and tables.

    Attributes
    ----------
    marks : tuple of str
        What a reader must see first; empty if all is in order.
    statements : tuple of str
        What a certificate says besides its figures.
    objects, facts, hashes : tuple of (title, text)
        The arms; who, when, where, under which conditions; SHA-256 of what it rests on.
    judgements : tuple of (words, judgement)
    """

    result: CertificateResult
    verdict: Verdict
    marks: tuple[str, ...]
    objects: tuple[tuple[str, str], ...]
    facts: tuple[tuple[str, str], ...]
    errors: Table
    judgements: tuple[tuple[str, Judgement], ...]
    tests: Table | None
    tests_words: str
    targets: Table | None
    statements: tuple[str, ...]
    budget: Table
    instruments: Table
    hashes: tuple[tuple[str, str], ...]


def certificate_section(data: ReportData) -> CertificateSection | None:
    """The stored certificate of a run for its page, marked where it no longer holds; None if there is none."""
    result = data.results.certificate
    return None if result is None else section_of(result, data.out_of_date.get(CERTIFICATE, ""))


def certificate_page(result: CertificateResult) -> str:
    """The certificate as an HTML page that needs no other file."""
    return template("certificate.html").render(certificate=section_of(result))


def section_of(result: CertificateResult, outdated: str = "") -> CertificateSection:
    """A certificate in words and tables; ``outdated`` says why it no longer holds."""
    return CertificateSection(
        result=result,
        verdict=certificate_verdict(result),
        marks=(
            *([f"this certificate is out of date: {outdated}"] if outdated else []),
            *result.warnings,
            *(f"out of date when it was issued: {one}" for one in result.out_of_date),
        ),
        objects=tuple((f"Arm {name}", _arm_words(arm)) for name, arm in result.arms.items()),
        facts=tuple(_facts(result)),
        errors=errors_table(result),
        judgements=tuple((judgement_words(one), one) for one in result.judgements),
        tests=None if result.iso9283 is None else iso_table(result.iso9283),
        tests_words="" if result.iso9283 is None else iso_sentence(result.iso9283),
        targets=targets_table(result) if result.targets else None,
        statements=tuple(statements(result)),
        budget=budget_table(result),
        instruments=instruments_table(result),
        hashes=tuple(_hashes(result)),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


def _facts(result: CertificateResult) -> list[tuple[str, str]]:
    """Who, when, where, under which conditions."""
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
    """A range of every arm, said once where all are alike."""
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


def _hashes(result: CertificateResult) -> list[tuple[str, str]]:
    """SHA-256 of everything that the certificate rests on."""
    data = result.data
    if data is None:
        return []
    stages = [
        (_STAGE_WORDS.get(name, f"model in force ({name})"), digest or "none made")
        for name, digest in data.stages.items()
    ]
    return [
        ("profile", data.profile),
        *((f"readings of arm {name}", digest) for name, digest in data.readings.items()),
        *stages,
        *([] if data.data_file is None else [("file that completed the profile", data.data_file)]),
    ]
