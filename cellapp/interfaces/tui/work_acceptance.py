"""The verbs of the screen Accept as jobs. Packages that a verb needs are loaded in the job's own thread."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.ground.control import JobControl
from cellapp.ground.progress import Listener
from cellapp.interfaces.tui.jobs import Ask, Job
from cellapp.interfaces.tui.work import on_run

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile
    from cellapp.commands.report.verdict_view import RunVerdict
    from cellapp.ground.results import Result
    from cellapp.interfaces.tui.dialogs.certificate import CertificateRequest, CheckFileRequest, SignKeyRequest


def certificate(folder: Path, request: CertificateRequest) -> Job:
    """Write the certificate of a run, and sign it where there is a key."""

    def work(run: RunFile, listener: Listener, control: JobControl, ask: Ask) -> Result:
        from cellapp.commands.certificate.run import certificate_run
        from cellapp.commands.certificate.sign_key import load_sign_key
        from cellapp.interfaces.page.certificate_page import certificate_page

        key = None if request.key is None else load_sign_key(request.key, request.passphrase)
        return certificate_run(
            run,
            certificate_page,
            out=request.out,
            number=request.number,
            data=request.data,
            key=key,
            pdf=request.pdf,
        )

    return on_run("certificate", folder, work)


def check_certificate(request: CheckFileRequest) -> Job:
    """Check signature and data of a certificate."""

    def work(listener: Listener, control: JobControl, ask: Ask) -> Result:
        from cellapp.cell.run import RunFile
        from cellapp.commands.certificate.run import check_certificate
        from cellapp.commands.certificate.sign_key import load_public_key

        key = None if request.key is None else load_public_key(request.key)
        if request.run is None:
            return check_certificate(request.certificate, key)
        with RunFile.open(request.run) as run:
            return check_certificate(request.certificate, key, run)

    return Job("check-certificate", work)


def sign_key(request: SignKeyRequest) -> Job:
    """Make a key pair that signs certificates."""

    def work(listener: Listener, control: JobControl, ask: Ask) -> Result:
        from cellapp.commands.certificate.sign_key import new_sign_key

        return new_sign_key(request.path, request.passphrase)

    return Job("sign-key", work)


def verdict(folder: Path) -> RunVerdict | None:
    """Judgements, marks and next steps of a run; None where it cannot be read. For a thread of its own."""
    from datetime import UTC, datetime

    from cellapp.cell.run import RunFile
    from cellapp.commands.report.verdict_view import read_verdict
    from cellapp.ground.errors import CellappError

    try:
        with RunFile.open(folder) as run:
            return read_verdict(run, datetime.now(UTC).date())
    except (CellappError, OSError, ValueError, TypeError):  # the last three: values of a damaged or foreign file
        return None  # the message line says what is wrong with the run
