"""The certificate as HTML: as a part of the page, and as a separate file that prints on A4."""

from __future__ import annotations

from dataclasses import dataclass

from cellapp.commands.certificate.result import CertificateResult
from cellapp.commands.certificate.view import certificate_marks, certificate_sections, certificate_verdict
from cellapp.commands.report.data import ReportData
from cellapp.commands.view.words import Verdict
from cellapp.ground.results import CERTIFICATE
from cellapp.interfaces.page.drawn import DrawnSection, drawn_sections
from cellapp.interfaces.page.templates import template


@dataclass(frozen=True)
class DrawnCertificate:
    """A certificate: its head, what a reader must see first, its verdict, and its sections."""

    result: CertificateResult
    marks: tuple[str, ...]
    verdict: Verdict
    sections: tuple[DrawnSection, ...]


def certificate_of_run(data: ReportData) -> DrawnCertificate | None:
    """Return the stored certificate of a run for its page, marked if out of date; None if there is none."""
    result = data.results.certificate
    return None if result is None else _drawn(result, data.out_of_date.get(CERTIFICATE, ""))


def certificate_page(result: CertificateResult) -> str:
    """Return the certificate as a self-contained HTML page."""
    return template("certificate.html").render(certificate=_drawn(result))


def _drawn(result: CertificateResult, outdated: str = "") -> DrawnCertificate:
    return DrawnCertificate(
        result,
        tuple(certificate_marks(result, outdated)),
        certificate_verdict(result),
        drawn_sections(certificate_sections(result), "certificate"),
    )
