"""The result of ``check-certificate`` as sentences."""

from __future__ import annotations

from cellapp.commands.check_certificate.request import CheckCertificateRequest
from cellapp.commands.check_certificate.result import CertificateCheckResult
from cellapp.commands.record import View


def view(result: CertificateCheckResult, request: CheckCertificateRequest | None = None) -> View:
    """Show what of a certificate holds, and every problem."""
    file = result.certificate if request is None else request.file
    failed = f"{file} does not hold: {'; '.join(result.problems)}"
    return View(check_sentences(result), [failed] if result.problems else (), held=f"signature {result.signature}")


def check_sentences(result: CertificateCheckResult) -> list[str]:
    """State what of a certificate holds, and every problem."""
    named = f"certificate {result.number}" if result.number else result.certificate
    key = f" (key {result.key_id})" if result.key_id else ""
    said = [f"{named}: signature {result.signature}{key}"]
    said += [f"{name}: {state}" for name, state in result.documents.items() if state != "changed"]
    if result.comment:
        said.append(f"signed comment: {result.comment.replace(chr(9), ', ')}")
    if result.run and not result.problems:
        said.append(f"the data of {result.run} are those that were signed")
    return [*said, *(f"PROBLEM: {problem}" for problem in result.problems)]
