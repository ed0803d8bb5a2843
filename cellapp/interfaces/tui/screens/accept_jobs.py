"""The jobs of the screen Accept: what is asked before each of them begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cellapp.commands.check.request import VERB as CHECK_VERB
from cellapp.commands.compensate.target_list import stale_model
from cellapp.commands.iso9283.request import VERB as ISO9283_VERB
from cellapp.commands.record import Request
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS
from cellapp.ground.results import CERTIFICATE, CHECK, ISO9283
from cellapp.interfaces.tui import work, work_acceptance
from cellapp.interfaces.tui.dialogs.certificate import (
    CertificateRequest,
    CheckCertificate,
    CheckFileRequest,
    NewSignKey,
    SignKeyRequest,
    WriteCertificate,
)
from cellapp.interfaces.tui.dialogs.question import Answer, Choice
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import BEGIN, USE_STALE, arms_words
from cellapp.interfaces.tui.workspace import NO_PROFILE, Workspace, new_folder

if TYPE_CHECKING:
    from cellapp.interfaces.tui.screens.accept import AcceptScreen

_PAGES = (
    Answer("page", "Page", "w", "success"),
    Answer("pdf", "Page and PDF", "d"),
    Answer("no", "Not now", "n"),
)


def ask_check(screen: AcceptScreen) -> None:
    """Ask how many stops, then measure them against the calibration."""
    if (calibrated := screen.calibrated_run()) is None:
        return
    folder, results, _ = calibrated

    def begin(request: Request | None) -> None:
        if request is not None:
            screen.show_tab(CHECK)
            screen.start(work.verb_job(CHECK_VERB, request))

    text = (
        "Drive to a few stops that tell most, and measure: does the calibration still hold? It ends as soon as it is"
        f" sure; no model is changed; {arms_words(screen.workspace)}."
    )
    if stale := stale_model(results):
        text += f"\nThe model is not up to date: {stale}."
    simulated = screen.workspace.kind == "simulated"
    screen.app.push_screen(VerbQuestion(CHECK_VERB, text, BEGIN, {"folder": folder}, simulated=simulated), begin)


def ask_iso9283(screen: AcceptScreen) -> None:
    """Ask which tests, then make them: in the run that is open, else in a new one of the profile."""
    workspace = screen.workspace
    profile, results = workspace.profile, workspace.results
    if profile is None:
        screen.say(NO_PROFILE, "warning")
        return
    folder = workspace.folder or new_folder(profile)
    calibrated = results is not None and results.calibrate is not None
    commands = ISO_COMMANDS if calibrated else ("nominal",)
    stale = stale_model(results) if results is not None and calibrated else ""

    def begin(request: Request | None) -> None:
        if request is not None:
            screen.show_tab(ISO9283)
            screen.start(work.verb_job(ISO9283_VERB, request))

    where = f", in {folder}" if workspace.folder is None else ""  # the first line of the screen shows that of a run
    text = f"Drive to the test cube's poses{where}; {arms_words(workspace)}."
    if stale:
        text += f"\nThe model is not up to date: {stale}."
    cell = workspace.profile_path if workspace.folder is None else None  # a run has its own
    dialog = VerbQuestion(
        ISO9283_VERB,
        text,
        USE_STALE if stale else BEGIN,
        {"profile": cell, "folder": folder, "out_of_date": bool(stale)},
        proposed={"tests": ("pose",), "commands": commands},
        choices={
            "tests": [test for test in ISO_TESTS if test != "cooperative" or len(profile.arms) > 1],
            "commands": commands,
            "arms": tuple(profile.arms),
        },
    )
    screen.app.push_screen(dialog, begin)


def ask_certificate(screen: AcceptScreen, key: str) -> None:
    """Ask for number, data and key, then write the certificate. ``key`` is the file that was used last."""
    folder = screen.open_folder()
    if folder is None:
        return

    def begin(request: CertificateRequest | None) -> None:
        if request is not None:
            screen.show_tab(CERTIFICATE)
            screen.key_file = "" if request.key is None else str(request.key)
            screen.start(work_acceptance.certificate(folder, request))

    screen.app.push_screen(WriteCertificate(_certificate_words(screen.workspace), key), begin)


def ask_check_file(screen: AcceptScreen) -> None:
    """Ask for a certificate and a public key, then check signature and data."""
    from cellapp.commands.out_of_date import CERTIFICATE_FILE

    def begin(request: CheckFileRequest | None) -> None:
        if request is not None:
            screen.show_tab(CERTIFICATE)
            screen.start(work_acceptance.check_certificate(request))

    folder = screen.workspace.folder
    written = None if folder is None else folder / CERTIFICATE_FILE
    proposed = str(written) if written is not None and written.is_file() else ""
    screen.app.push_screen(CheckCertificate(proposed, folder), begin)


def ask_sign_key(screen: AcceptScreen) -> None:
    """Ask where a new key goes, then make it."""

    def begin(request: SignKeyRequest | None) -> None:
        if request is not None:
            screen.key_file = str(request.path)
            screen.start(work_acceptance.sign_key(request))

    screen.app.push_screen(NewSignKey(), begin)


def ask_report(screen: AcceptScreen) -> None:
    """Ask for page or page and PDF, then write."""
    if (calibrated := screen.calibrated_run()) is None:
        return
    folder, _, _ = calibrated

    def begin(answer: str | None) -> None:
        if answer in ("page", "pdf"):
            screen.start(work.report(folder, pdf=answer == "pdf"))

    text = f"Write report.html in {folder}; an installed Chromium prints it to report.pdf."
    screen.app.push_screen(Choice("Write the report?", text, _PAGES), begin)


def _certificate_words(workspace: Workspace) -> str:
    """What a person must know before a certificate is written."""
    complaints = () if workspace.overview is None else workspace.overview.complaints
    marks = f" OUT OF DATE: {'; '.join(complaints)}." if complaints else ""
    return f"What was measured in {workspace.folder}, judged by its tolerances; what nobody gave is named.{marks}"
