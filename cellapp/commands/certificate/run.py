"""The verb ``certificate``: write what a run proves, all that it rests on, and the sums of these files."""

from __future__ import annotations

import hashlib
import re
import tempfile
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from cellapp.cell.profile.loader import with_sections
from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.cell.run.csv_export import write_recordings_csv
from cellapp.cell.run.recordings import all_known_readings, recording_states
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.commands.certificate.request import CertificateRequest
from cellapp.commands.certificate.statement import certificate_of
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.record import Work
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import CERTIFICATE_FILE, Basis, RunStages, append_stage, basis_of, read_history
from cellapp.estimation.uncertainty.budget import measured_conditions
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE, CERTIFICATE, ISO9283, VERIFY, StageName
from cellapp.ground.shell import shell_word
from cellapp.robot.effects.registry import program_of

PAGE_FILE = "certificate.html"
SUMS_FILE = "SHA256SUMS"
DATA_FOLDER = "certified"
"""Folder of the files that a certificate rests on, beside it. Later results of the run do not change them."""
DATA_SECTIONS = ("tolerances", "traceability")
"""Sections of the profile that a file may complete."""
CERTIFIED_STAGES: tuple[StageName, ...] = (VERIFY, ISO9283)
"""Measurements whose figures a certificate states."""
_LONGEST_NUMBER, _LONGEST_NAME = 60, 30
_NUMBER = re.compile(rf"(?=.{{1,{_LONGEST_NUMBER}}}$)[\w./+-]+(?: [\w./+-]+)*", re.ASCII)
"""Pattern of a number that fits into a file name and a heading."""


def run(request: CertificateRequest, work: Work) -> CertificateResult:
    """Write the certificate of a run."""
    with RunFile.open(request.folder, write=True) as opened:
        return certify(opened, request, work)


def certify(run: RunFile, request: CertificateRequest, work: Work, now: datetime | None = None) -> CertificateResult:
    """Write the certificate of a run with all that it rests on and the sums of these files; store it as a stage.

    In the run's folder, files without a signature beside their sums may be replaced.

    Raises
    ------
    InputError
        If the run is read-only or nothing was measured, ``number`` or ``data`` is not valid, the folder holds a signed
        certificate, or the files cannot be written. Nothing is stored then.
    """
    if not run.writable:
        raise InputError(f"{run.path} is open for reading only; open it for writing")
    allowed = RENEWED if request.out is None else work.outputs
    folder = request.out or run.folder
    allowed.check_file(folder / SUMS_FILE)
    shown = (CERTIFICATE_FILE, PAGE_FILE)
    profile = run.profile if request.data is None else with_sections(run.profile, request.data, DATA_SECTIONS)
    state = RunState(run)
    stages = state.stages
    if not any(name in stages.current for name in (CALIBRATE, *CERTIFIED_STAGES)):
        word = shell_word(run.folder)
        raise InputError(
            f"{run.folder}: nothing here was measured that a certificate could state: no calibration"
            f" ('cellapp calibrate {word}'), no verified targets ('cellapp push {word} TARGETS --verify'), no test"
            f" ('cellapp iso9283 --run {word}')"
        )
    basis = certified_basis(run, stages)
    with tempfile.TemporaryDirectory(prefix="cellapp-certificate-") as temporary:
        made = Path(temporary)
        certified = _certified_files(run, stages, request.data, made)
        written_at = now or datetime.now(UTC)
        rests_on = {name: _sum(made / name) for name in certified}
        result = certificate_of(
            profile,
            state.results,
            measured_conditions(all_known_readings(run)),
            recorded_controllers(run),
            _times_of_measuring(run, stages),
            program_of(profile),
            number=_checked_number(request.number) or _new_number(run, profile, written_at, basis),
            run=str(run.folder),
            issued=written_at.astimezone(UTC).isoformat(timespec="seconds"),
            rests_on=rests_on,
            files=(*shown, SUMS_FILE),
        )
        RENEWED.write_text(made / CERTIFICATE_FILE, result.to_json(indent=1) + "\n")
        RENEWED.write_text(made / PAGE_FILE, work.certificate_page(result))
        sums = {**{name: _sum(made / name) for name in shown}, **rests_on}
        RENEWED.write_text(made / SUMS_FILE, "".join(f"{digest}  {name}\n" for name, digest in sums.items()))
        written = (*certified, *result.files)
        for name in written:
            allowed.check_file(folder / name)
        _make(folder / DATA_FOLDER)
        for name in written:
            allowed.write(folder / name, (made / name).read_bytes())
    append_stage(run, CERTIFICATE, result, basis)
    return result


def _certified_files(run: RunFile, stages: RunStages, data: Path | None, made: Path) -> list[str]:
    """Write what the certificate rests on below ``made``, and return the names: ``sha256sum`` can only check files."""
    folder = made / DATA_FOLDER
    folder.mkdir()
    texts = {"profile.json": run.profile_text}
    if stages.in_force is not None and stages.in_force.model is not None:
        texts["model.json"] = stages.in_force.model
    texts |= {f"{name}.json": stages.current[name].text for name in CERTIFIED_STAGES if name in stages.current}
    for name, text in texts.items():
        RENEWED.write_text(folder / name, text)
    if data is not None:
        RENEWED.write(folder / "completed.yaml", data.read_bytes())
    if run.arms():
        write_readings_csv(run, folder / "readings.csv")
    if recording_states(run):
        write_recordings_csv(run, "joints", folder / "joints.csv")
        write_recordings_csv(run, "points", folder / "points.csv")
    return [path.relative_to(made).as_posix() for path in sorted(folder.iterdir())]


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give another folder") from None


# -- inside -----------------------------------------------------------------------------------------------------------


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


def _checked_number(number: str | None) -> str:
    if number is not None and not _NUMBER.fullmatch(number):
        raise InputError(
            f"certificate: --number: expected up to {_LONGEST_NUMBER} letters, digits, blanks and ./+-_, got {number!r}"
        )
    return number or ""


def _new_number(run: RunFile, profile: Profile, written: datetime, basis: Basis) -> str:
    """Make a number of profile, day, the first digits of the basis' hash, and a count if it was used before."""
    name = re.sub(r"[^\w.+-]+", "-", profile.name, flags=re.ASCII).strip("-")[:_LONGEST_NAME] or "cell"
    digest = hashlib.sha256(basis.model_dump_json().encode()).hexdigest()
    number, used = f"{name}-{written:%Y%m%d}-{digest[:8]}", set[str]()
    for stage in read_history(run):
        if stage.name == CERTIFICATE:
            with suppress(InputError):  # another version stored it
                used.add(CertificateResult.from_json(stage.text, CERTIFICATE).number)
    further = (f"{number}-{count}" for count in range(2, len(used) + 2))
    return next(one for one in (number, *further) if one not in used)
