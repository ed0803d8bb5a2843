"""The verb ``check-certificate``: verify a certificate's signature, its pages and its data."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Collection
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from cellapp.cell.profile.files import path_exists
from cellapp.cell.run import RunFile
from cellapp.commands.basis import Basis
from cellapp.commands.certificate.result import CertificateResult, CertifiedData
from cellapp.commands.certificate.run import (
    CERTIFIED_STAGES,
    PAGE_FILE,
    PRINT_FILE,
    SIGNATURE_SUFFIX,
    certified_basis,
    content_of,
    issued,
)
from cellapp.commands.check_certificate.request import CheckCertificateRequest
from cellapp.commands.check_certificate.result import CertificateCheckResult, DocumentState, SignatureState
from cellapp.commands.out_of_date import CERTIFICATE_FILE
from cellapp.commands.record import Work
from cellapp.commands.sign_key.keys import load_public_key
from cellapp.commands.sign_key.minisign import FormatError, PublicKey, Signature
from cellapp.commands.stages import STORED_OTHERWISE, read_history, read_stages
from cellapp.ground.errors import InputError
from cellapp.ground.results import CERTIFICATE, ISO9283, VERIFY

_SHOWN = (".html", ".htm", ".pdf")
"""Suffixes of files that show a certificate to people."""
_OTHER_MODEL = "another model is in force since"


def run(request: CheckCertificateRequest, work: Work) -> CertificateCheckResult:
    """Verify a certificate; with a run also that its data are the signed ones."""
    key = None if request.public_key is None else load_public_key(request.public_key)
    with nullcontext() if request.run is None else RunFile.open(request.run) as opened:
        return check_certificate(request.file, key, opened)


def check_certificate(
    path: Path, public_key: PublicKey | None = None, run: RunFile | None = None
) -> CertificateCheckResult:
    """Verify a certificate's signature, the files that show it, and that a run is still the one it was made from.

    ``path`` is the certificate, or a page or print of it next to the certificate. ``problems`` of the result name
    whatever does not hold; a missing public key is one of them. Raises ``InputError`` if ``path`` cannot be read.
    """
    shown = path if path.suffix.lower() in _SHOWN else None
    path = path if shown is None else path.with_name(CERTIFICATE_FILE)
    content = content_of(path)
    checked = _checked_signature(path, content, public_key)
    problems = [checked.problem] if checked.problem else []
    certificate: CertificateResult | None = None
    try:
        certificate = CertificateResult.from_json(content.decode("utf-8"), str(path))
    except (InputError, UnicodeDecodeError):
        problems.append("it is no certificate that this cellapp can read")
    certified = {} if certificate is None else {Path(name).name: sha for name, sha in certificate.documents.items()}
    documents = {name: _document(path.parent / name, sha) for name, sha in certified.items()}
    changed = [name for name, state in documents.items() if state == "changed"]
    problems += [f"{name} was changed: it is not the file that was certified" for name in changed]
    if certificate is not None:
        problems += _uncovered(certificate, path.parent, shown)
    if certificate is not None and run is not None:
        problems += _changes(certificate, run)
    return CertificateCheckResult(
        certificate=str(path),
        number="" if certificate is None else certificate.number,
        signature=checked.state,
        key_id=checked.key_id,
        comment=checked.comment,
        documents=documents,
        run="" if run is None else str(run.folder),
        problems=tuple(problems),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Checked:
    """The signature's statement on a certificate; ``problem`` is empty if it holds."""

    state: SignatureState
    key_id: str = ""
    comment: str = ""
    problem: str = ""


def _checked_signature(path: Path, content: bytes, public_key: PublicKey | None) -> _Checked:
    signed = path.with_name(path.name + SIGNATURE_SUFFIX)
    if not path_exists(signed):
        return _Checked("missing", problem=f"not signed: {signed.name} is not beside the certificate")
    try:
        signature = Signature.parse(content_of(signed).decode("utf-8"))
    except (FormatError, UnicodeDecodeError) as error:
        why = str(error) if isinstance(error, FormatError) else "not a text"
        return _Checked("wrong", problem=f"{signed.name} is no signature of minisign: {why}")
    key_id = signature.id_text
    if public_key is None:
        problem = f"the signature by key {key_id} was not checked; give the signer's key with --public-key"
        return _Checked("not checked", key_id, problem=problem)
    if not signature.is_by(public_key):
        return _Checked("other key", key_id, problem=f"signed by key {key_id}, not by key {public_key.id_text}")
    if not signature.holds(content, public_key):
        problem = "the signature does not fit: the certificate or its signature was changed"
        return _Checked("wrong", key_id, problem=problem)
    return _Checked("valid", key_id, signature.trusted_comment)


def _document(path: Path, sha256: str) -> DocumentState:
    if not path_exists(path):
        return "not here"
    same = hmac.compare_digest(hashlib.sha256(content_of(path)).hexdigest(), sha256)
    return "as certified" if same else "changed"


def _uncovered(certificate: CertificateResult, folder: Path, shown: Path | None) -> list[str]:
    """Return files that show a certificate which has no hash of them: they may contain anything."""
    usual = [folder / name for name in (PAGE_FILE, PRINT_FILE) if path_exists(folder / name)]
    beside = {one.name for one in (*usual, *([] if shown is None else [shown]))} - set(certificate.documents)
    return [f"{name} is not covered by the certificate, which states no hash of it" for name in sorted(beside)]


def _changes(certificate: CertificateResult, run: RunFile) -> list[str]:
    """Say where a run differs from the one that a certificate was made from."""
    data, stages = certificate.data, read_stages(run)
    if data is None:
        return ["it does not say which data it rests on"]
    now = certified_basis(run, stages)
    same = {name for name, one in now.readings.items() if data.readings.get(name) == one.sha256}
    changed = sorted((set(now.readings) | set(data.readings)) - same)
    if not same and data.profile != now.profile:
        return [f"{run.folder} is another run: neither its profile nor its readings are those of the certificate"]
    return [
        *([] if data.profile == now.profile else ["the profile of the run was changed since"]),
        *(f"the readings of arm {name} were changed or added since" for name in changed),
        *_changed_stages(data, now, {one.digest for one in read_history(run) if one.name in CERTIFIED_STAGES}),
        *(f"'{name}' is out of date ({why})" for name, why in stages.out_of_date.items() if name != CERTIFICATE),
        *_stored_otherwise(certificate, run),
    ]


def _changed_stages(data: CertifiedData, now: Basis, stored: Collection[str]) -> list[str]:
    """Name changed stages; ``stored`` are the digests of all measurements in the run: they include the certified
    one."""
    if set(data.stages) - set(CERTIFIED_STAGES) != set(now.stages) - set(CERTIFIED_STAGES):
        return [_OTHER_MODEL]
    words = {VERIFY: "targets were verified since", ISO9283: "the cell was tested by ISO 9283 since"}
    changed = [name for name, one in now.stages.items() if not hmac.compare_digest(data.stages.get(name, ""), one)]
    since = {name for name in words if data.stages.get(name, "") in ("", *stored)}
    return [
        words.get(name, _OTHER_MODEL) if name in since else STORED_OTHERWISE.get(name, _OTHER_MODEL) for name in changed
    ]


def _stored_otherwise(certificate: CertificateResult, run: RunFile) -> list[str]:
    """Say that the certificate is not the stored one: the run keeps every certificate, also without its signature."""
    if certificate in issued(run):
        return []
    return ["the run does not store this certificate: it was made for another run, or it was changed"]
