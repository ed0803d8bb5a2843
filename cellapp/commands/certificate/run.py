"""The verbs ``certificate`` and ``check-certificate``: read a run, write and sign what it proves, verify that again."""

from __future__ import annotations

import hashlib
import hmac
import re
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.cell.driving.controllers import recorded_controllers
from cellapp.cell.profile.files import path_exists
from cellapp.cell.profile.loader import with_sections
from cellapp.cell.run import RunFile
from cellapp.commands.basis import Basis, basis_of
from cellapp.commands.certificate.minisign import FormatError, PublicKey, Signature, sign
from cellapp.commands.certificate.result import CertificateCheckResult, CertificateResult, CertifiedData, DocumentState
from cellapp.commands.certificate.statement import CertificateInput, Controller, certificate_of
from cellapp.commands.out_of_date import CERTIFICATE_FILE
from cellapp.commands.run_results import read_stage_results
from cellapp.commands.stages import STORED_OTHERWISE, RunStages, append_stage, read_history, read_stages
from cellapp.estimation.uncertainty.conditions import measured_conditions
from cellapp.ground.chromium import find_chromium, print_pdf
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, RENEWED, Outputs
from cellapp.ground.profile import Profile
from cellapp.ground.results import CERTIFICATE, ISO9283, VERIFY, StageName
from cellapp.robot.plugins import program_of

PAGE_FILE = "certificate.html"
PRINT_FILE = "certificate.pdf"
SIGNATURE_SUFFIX = ".minisig"
SIGNATURE_FILE = CERTIFICATE_FILE + SIGNATURE_SUFFIX
DATA_SECTIONS = ("tolerances", "traceability")
"""Sections of the profile that a file may complete."""
CERTIFIED_STAGES: tuple[StageName, ...] = (VERIFY, ISO9283)
"""Measurements of which a certificate states figures."""
_LONGEST_NUMBER, _LONGEST_NAME = 60, 30
_NUMBER = re.compile(rf"(?=.{{1,{_LONGEST_NUMBER}}}$)[\w./+-]+(?: [\w./+-]+)*", re.ASCII)
"""Words that fit into a file name, a signed comment and a heading."""
_MOST_BYTES = 50_000_000
"""A certificate has some ten thousand bytes."""
_SHOWN = (".html", ".htm", ".pdf")
"""Files that show a certificate to people."""
PageOf = Callable[[CertificateResult], str]
"""Draws the page of a certificate as HTML."""
_OTHER_MODEL = "another model is in force since"


@dataclass(frozen=True)
class _Asked:
    """What was asked for: number (empty for a new one), time, hash of the file with data, documents, key that signs."""

    number: str
    written: datetime
    data_sha256: str | None
    documents: tuple[str, ...]
    key_id: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all files that are written."""
        return (CERTIFICATE_FILE, *self.documents, *([SIGNATURE_FILE] if self.key_id else []))


def certificate_run(
    run: RunFile,
    page: PageOf,
    *,
    out: Path | None = None,
    number: str | None = None,
    data: Path | None = None,
    key: Ed25519PrivateKey | None = None,
    pdf: bool = False,
    now: datetime | None = None,
    outputs: Outputs = NEW_ONLY,
) -> CertificateResult:
    """Write the certificate of a run, sign it if a key is given, and store it as a stage.

    Parameters
    ----------
    page : callable
        Draws the page that shows the certificate to people.
    out : path, optional
        Folder of the files; the run's own if not given.
    number : str, optional
        Of the certificate; made of profile, day and data if not given.
    data : path, optional
        YAML with the profile's sections ``tolerances`` and ``traceability``; its keys come before the profile's.
    pdf : bool
        Print the page to a PDF, too, through an installed Chromium.
    outputs : Outputs
        What may be replaced in a folder ``out``; left out, nothing. In the run's folder an unsigned one is.

    Raises
    ------
    InputError
        If the run is open for reading only, ``number`` or ``data`` is not valid, a signed certificate stands in the
        folder, nothing here prints, or the files cannot be written. Nothing is stored then.
    """
    if not run.writable:
        raise InputError(f"{run.path} is open for reading only; open it for writing")
    folder = out or run.folder
    if path_exists(folder / SIGNATURE_FILE):
        raise InputError(
            f"certificate: {folder / SIGNATURE_FILE}: a signed certificate is never replaced; move it, or give another"
            " folder with --out"
        )
    asked = _Asked(
        number=_checked_number(run, number),
        written=now or datetime.now(UTC),
        data_sha256=None if data is None else hashlib.sha256(_content(data)).hexdigest(),
        documents=(PAGE_FILE, *([PRINT_FILE] if pdf else [])),
        key_id="" if key is None else PublicKey.of(key).id_text,
    )
    if pdf:
        find_chromium()
    allowed = RENEWED if out is None else outputs
    for name in asked.files:
        allowed.check_file(folder / name)
    profile = run.profile if data is None else with_sections(run.profile, data, DATA_SECTIONS)
    stages = read_stages(run)
    basis = _basis(run, stages)
    shown = certificate_of(_input(run, profile, basis, stages, asked))
    documents = _documents(page(shown).encode(), pdf=pdf)
    hashes = {name: hashlib.sha256(text).hexdigest() for name, text in documents.items()}
    result = shown.model_copy(update={"documents": hashes})
    content = (result.to_json(indent=1) + "\n").encode()
    files = {CERTIFICATE_FILE: content, **documents}
    if key is not None:
        comment = f"timestamp:{int(asked.written.timestamp())}\tfile:{CERTIFICATE_FILE}\tnumber:{result.number}"
        files[SIGNATURE_FILE] = sign(content, key, comment).text().encode()
    _make(folder)
    for name, text in files.items():
        allowed.write(folder / name, text)
    append_stage(run, CERTIFICATE, result, basis)
    return result


def _documents(page: bytes, *, pdf: bool) -> dict[str, bytes]:
    """The files that show a certificate to people, name -> content: its page and a print of that."""
    if not pdf:
        return {PAGE_FILE: page}
    with tempfile.TemporaryDirectory(prefix="cellapp-certificate-") as folder:
        shown, printed = Path(folder) / PAGE_FILE, Path(folder) / PRINT_FILE
        RENEWED.write(shown, page)
        print_pdf(shown, printed)
        return {PAGE_FILE: page, PRINT_FILE: printed.read_bytes()}


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give another folder") from None


def check_certificate(
    path: Path, public_key: PublicKey | None = None, run: RunFile | None = None
) -> CertificateCheckResult:
    """Verify the signature of a certificate, the files that show it, and that a run is still the one it was made from.

    ``path`` is the certificate, or a page or print of it; then the certificate stands beside. ``problems`` of the
    result name whatever does not hold; without a public key the signature is one of them. Raises ``InputError`` if
    ``path`` cannot be read.
    """
    shown = path if path.suffix.lower() in _SHOWN else None
    path = path if shown is None else path.with_name(CERTIFICATE_FILE)
    content = _content(path)
    checked = _checked_signature(path, content, public_key)
    problems = [checked.problem] if checked.problem else []
    certificate: CertificateResult | None = None
    try:
        certificate = CertificateResult.from_json(content.decode("utf-8"), str(path))
    except (InputError, UnicodeDecodeError):
        problems.append("it is no certificate that this cellapp can read")
    documents = {} if certificate is None else _checked_documents(certificate, path.parent)
    problems += [f"{name} was changed: it is not the file that was certified" for name in _changed(documents)]
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


# -- making -----------------------------------------------------------------------------------------------------------


def _input(run: RunFile, profile: Profile, basis: Basis, stages: RunStages, asked: _Asked) -> CertificateInput:
    readings = {name: run.readings(name) for name in run.arms()}
    return CertificateInput(
        number=asked.number or _new_number(run, profile, asked.written, basis),
        run=str(run.folder),
        issued=asked.written.astimezone(UTC).isoformat(timespec="seconds"),
        program=program_of(profile),
        profile=profile,
        results=read_stage_results(run, stages),
        conditions=measured_conditions(readings),
        controllers={
            name: Controller(one.model, one.serial, one.software) for name, one in recorded_controllers(run).items()
        },
        measured=_times_of_measuring(run, stages),
        data=CertifiedData(
            profile=basis.profile,
            readings={name: one.sha256 for name, one in basis.readings.items()},
            model=None if stages.in_force is None else stages.in_force.name,
            stages=basis.stages,
            data_file=asked.data_sha256,
        ),
        files=asked.files,
        key_id=asked.key_id,
    )


def _basis(run: RunFile, stages: RunStages) -> Basis:
    """What a certificate rests on; the digest of a measurement that was not made is empty."""
    model = {} if stages.in_force is None else {stages.in_force.name: stages.in_force.digest}
    made = {name: stages.current[name].digest if name in stages.current else "" for name in CERTIFIED_STAGES}
    return basis_of(run, model | made)


def _times_of_measuring(run: RunFile, stages: RunStages) -> tuple[str, ...]:
    """First and last time (ISO 8601, UTC) of collecting and of what the certificate states; empty if none is known."""
    times = [time for one in run.sessions() for time in (one.began, one.ended) if time is not None]
    times += [stages.current[name].written for name in CERTIFIED_STAGES if name in stages.current]
    return (min(times), max(times)) if times else ()


def _checked_number(run: RunFile, number: str | None) -> str:
    if number is not None and not _NUMBER.fullmatch(number):
        raise InputError(
            f"certificate: --number: expected up to {_LONGEST_NUMBER} letters, digits, blanks and ./+-_, got {number!r}"
        )
    if any(one.number == number and one.signed for one in _issued(run)):
        raise InputError(
            f"certificate: --number: a signed certificate {number} of this run exists; give another number"
        )
    return number or ""


def _issued(run: RunFile) -> list[CertificateResult]:
    """Every certificate that the run stores and this version can read."""
    found = []
    for stage in read_history(run):
        if stage.name == CERTIFICATE:
            with suppress(InputError):
                found.append(CertificateResult.from_json(stage.text, CERTIFICATE))
    return found


def _new_number(run: RunFile, profile: Profile, written: datetime, basis: Basis) -> str:
    """Profile, day, the first digits of a hash of all that the certificate rests on, and a count if that was used."""
    name = re.sub(r"[^\w.+-]+", "-", profile.name, flags=re.ASCII).strip("-")[:_LONGEST_NAME] or "cell"
    digest = hashlib.sha256(basis.model_dump_json().encode()).hexdigest()
    number, used = f"{name}-{written:%Y%m%d}-{digest[:8]}", {one.number for one in _issued(run)}
    further = (f"{number}-{count}" for count in range(2, len(used) + 2))
    return next(one for one in (number, *further) if one not in used)


# -- checking ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Checked:
    """What the signature file says of the certificate; ``problem`` is empty if it holds."""

    state: Literal["valid", "wrong", "missing", "other key", "not checked"]
    key_id: str = ""
    comment: str = ""
    problem: str = ""


def _checked_signature(path: Path, content: bytes, public_key: PublicKey | None) -> _Checked:
    signed = path.with_name(path.name + SIGNATURE_SUFFIX)
    if not path_exists(signed):
        return _Checked("missing", problem=f"not signed: {signed.name} is not beside the certificate")
    try:
        signature = Signature.parse(_content(signed).decode("utf-8"))
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


def _checked_documents(certificate: CertificateResult, folder: Path) -> dict[str, DocumentState]:
    """Whether each file that shows the certificate is the one that was certified."""
    return {Path(name).name: _document(folder / Path(name).name, sha) for name, sha in certificate.documents.items()}


def _document(path: Path, sha256: str) -> DocumentState:
    if not path_exists(path):
        return "not here"
    same = hmac.compare_digest(hashlib.sha256(_content(path)).hexdigest(), sha256)
    return "as certified" if same else "changed"


def _changed(documents: Mapping[str, DocumentState]) -> list[str]:
    return [name for name, state in documents.items() if state == "changed"]


def _uncovered(certificate: CertificateResult, folder: Path, shown: Path | None) -> list[str]:
    """Files that show a certificate and of which it has no hash: anything may stand in them."""
    usual = [folder / name for name in (PAGE_FILE, PRINT_FILE) if path_exists(folder / name)]
    beside = {one.name for one in (*usual, *([] if shown is None else [shown]))} - set(certificate.documents)
    return [f"{name} is not covered by the certificate, which states no hash of it" for name in sorted(beside)]


def _changes(certificate: CertificateResult, run: RunFile) -> list[str]:
    """Where a run is not, or no longer, what a certificate was made from."""
    data, stages = certificate.data, read_stages(run)
    if data is None:
        return ["it does not say which data it rests on"]
    now = _basis(run, stages)
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
    """``stored`` are digests of all measurements that the run keeps: without the certified one it was changed."""
    if set(data.stages) - set(CERTIFIED_STAGES) != set(now.stages) - set(CERTIFIED_STAGES):
        return [_OTHER_MODEL]
    words = {VERIFY: "targets were verified since", ISO9283: "the cell was tested by ISO 9283 since"}
    changed = [name for name, one in now.stages.items() if not hmac.compare_digest(data.stages.get(name, ""), one)]
    since = {name for name in words if data.stages.get(name, "") in ("", *stored)}
    return [
        words.get(name, _OTHER_MODEL) if name in since else STORED_OTHERWISE.get(name, _OTHER_MODEL) for name in changed
    ]


def _stored_otherwise(certificate: CertificateResult, run: RunFile) -> list[str]:
    """The run keeps every certificate: a file that was changed is found without its signature, too."""
    if certificate in _issued(run):
        return []
    return ["the run does not store this certificate: it was made for another run, or it was changed"]


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a certificate.json") from None
