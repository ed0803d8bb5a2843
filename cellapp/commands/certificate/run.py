"""The verb ``certificate``: write and sign what a run proves."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.cell.profile.files import path_exists
from cellapp.cell.profile.loader import with_sections
from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import recorded_controllers
from cellapp.cell.run.samples import all_known_readings
from cellapp.commands.basis import Basis, basis_of
from cellapp.commands.certificate.request import CertificateRequest
from cellapp.commands.certificate.result import CertificateResult, CertifiedData
from cellapp.commands.certificate.statement import CertificateInput, Controller, certificate_of
from cellapp.commands.out_of_date import CERTIFICATE_FILE
from cellapp.commands.record import PASSPHRASE_VARIABLE, Work
from cellapp.commands.run_results import read_stage_results
from cellapp.commands.sign_key.keys import is_encrypted, load_sign_key
from cellapp.commands.sign_key.minisign import PublicKey, sign
from cellapp.commands.stages import RunStages, append_stage, read_history, read_stages
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
"""Measurements whose figures a certificate states."""
_LONGEST_NUMBER, _LONGEST_NAME = 60, 30
_NUMBER = re.compile(rf"(?=.{{1,{_LONGEST_NUMBER}}}$)[\w./+-]+(?: [\w./+-]+)*", re.ASCII)
"""Pattern of a number that fits into a file name, a signed comment and a heading."""
_MOST_BYTES = 50_000_000
"""Largest file that is read; a certificate has some ten thousand bytes."""
PageOf = Callable[[CertificateResult], str]
"""Draws the page of a certificate as HTML."""


@dataclass(frozen=True)
class _Asked:
    """The request: number (empty for a new one), time, hash of the data file, documents, id of the signing key."""

    number: str
    written: datetime
    data_sha256: str | None
    documents: tuple[str, ...]
    key_id: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of all files to write."""
        return (CERTIFICATE_FILE, *self.documents, *([SIGNATURE_FILE] if self.key_id else []))


def run(request: CertificateRequest, work: Work) -> CertificateResult:
    """Write the certificate of a run, signed if there is a key."""
    key = None if request.key is None else _private_key(request, request.key, work)
    with RunFile.open(request.folder, write=True) as opened:
        return certificate_run(
            opened,
            work.certificate_page,
            out=request.out,
            number=request.number,
            data=request.data,
            key=key,
            pdf=request.pdf,
            outputs=work.outputs,
        )


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
        Of the certificate; by default made of profile, day and data.
    data : path, optional
        YAML with the profile's sections ``tolerances`` and ``traceability``; its keys override the profile's.
    pdf : bool
        Also print the page to a PDF, with an installed Chromium.
    outputs : Outputs
        Which files in a folder ``out`` may be replaced; none by default. In the run's folder an unsigned one may be.

    Raises
    ------
    InputError
        If the run is read-only, ``number`` or ``data`` is not valid, the folder holds a signed certificate, nothing
        here can print, or the files cannot be written. Nothing is stored then.
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
        data_sha256=None if data is None else hashlib.sha256(content_of(data)).hexdigest(),
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
    basis = certified_basis(run, stages)
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
    """Return the files for people, name -> content: the page, and its print on request."""
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


# -- making -----------------------------------------------------------------------------------------------------------


def _private_key(request: CertificateRequest, path: Path, work: Work) -> Ed25519PrivateKey:
    if not is_encrypted(path):
        return load_sign_key(path)
    given = request.passphrase
    secret = work.secret(f"Passphrase of {path}", False) if given is None else given.get_secret_value()
    if secret is None:
        raise InputError(f"{path}: the key is encrypted; set {PASSPHRASE_VARIABLE}, or run this in a terminal")
    return load_sign_key(path, secret)


def _input(run: RunFile, profile: Profile, basis: Basis, stages: RunStages, asked: _Asked) -> CertificateInput:
    readings = all_known_readings(run)
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


def certified_basis(run: RunFile, stages: RunStages) -> Basis:
    """Return the basis of a certificate; the digest of a missing measurement is empty."""
    model = {} if stages.in_force is None else {stages.in_force.name: stages.in_force.digest}
    made = {name: stages.current[name].digest if name in stages.current else "" for name in CERTIFIED_STAGES}
    return basis_of(run, model | made)


def _times_of_measuring(run: RunFile, stages: RunStages) -> tuple[str, ...]:
    """Return the first and last time (ISO 8601, UTC) of collecting and of certified measurements; empty if unknown."""
    times = [time for one in run.sessions() for time in (one.began, one.ended) if time is not None]
    times += [stages.current[name].written for name in CERTIFIED_STAGES if name in stages.current]
    return (min(times), max(times)) if times else ()


def _checked_number(run: RunFile, number: str | None) -> str:
    if number is not None and not _NUMBER.fullmatch(number):
        raise InputError(
            f"certificate: --number: expected up to {_LONGEST_NUMBER} letters, digits, blanks and ./+-_, got {number!r}"
        )
    if any(one.number == number and one.signed for one in issued(run)):
        raise InputError(
            f"certificate: --number: a signed certificate {number} of this run exists; give another number"
        )
    return number or ""


def issued(run: RunFile) -> list[CertificateResult]:
    """Return all certificates in the run that this version can read."""
    found = []
    for stage in read_history(run):
        if stage.name == CERTIFICATE:
            with suppress(InputError):
                found.append(CertificateResult.from_json(stage.text, CERTIFICATE))
    return found


def _new_number(run: RunFile, profile: Profile, written: datetime, basis: Basis) -> str:
    """Make a number of profile, day, the first digits of the basis' hash, and a count if it was used before."""
    name = re.sub(r"[^\w.+-]+", "-", profile.name, flags=re.ASCII).strip("-")[:_LONGEST_NAME] or "cell"
    digest = hashlib.sha256(basis.model_dump_json().encode()).hexdigest()
    number, used = f"{name}-{written:%Y%m%d}-{digest[:8]}", {one.number for one in issued(run)}
    further = (f"{number}-{count}" for count in range(2, len(used) + 2))
    return next(one for one in (number, *further) if one not in used)


def content_of(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a certificate.json") from None
