"""The jobs of the screen Accept, with the questions before each."""

from __future__ import annotations

from cellapp.commands.certificate.request import VERB as CERTIFICATE_VERB
from cellapp.commands.check.request import VERB as CHECK_VERB
from cellapp.commands.compensate.target_list import stale_model
from cellapp.commands.iso9283.request import VERB as ISO9283_VERB
from cellapp.commands.record import Request
from cellapp.commands.report.request import VERB as REPORT
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS
from cellapp.ground.results import CERTIFICATE, CHECK, ISO9283, StageName
from cellapp.interfaces.tui import work
from cellapp.interfaces.tui.dialogs.question import Answer, Choice
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.offers import BEGIN, USE_STALE, arms_words, ask_of_calibrated
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.workspace import Workspace, new_folder

_PAGES = (
    Answer("page", "Page", "w", "success"),
    Answer("pdf", "Page and PDF", "d"),
    Answer("no", "Not now", "n"),
)


class ScreenOfResults(DayScreen):
    """Interface of the screen Accept for these jobs: it has a tab for each result."""

    def show_tab(self, stage: StageName) -> None:
        """Show the tab of a result."""
        raise NotImplementedError


def ask_check(screen: ScreenOfResults) -> None:
    """Ask how many stops, then measure them against the calibration."""
    words = (
        "Drive to a few stops that tell most, and measure: does the calibration still hold? It ends as soon as it is"
        " sure; no model is changed;"
    )
    ask_of_calibrated(screen, CHECK_VERB, words, lambda: screen.show_tab(CHECK))


def ask_iso9283(screen: ScreenOfResults) -> None:
    """Ask which tests, then make them in the open run, or else in a new run of the profile."""
    workspace = screen.workspace
    profile, results = workspace.profile, workspace.results
    if profile is None:
        screen.say(screen.state.no_run, "warning")
        return
    folder = workspace.folder or new_folder(profile)
    calibrated = results is not None and results.calibrate is not None
    commands = ISO_COMMANDS if calibrated else ("nominal",)
    stale = stale_model(results) if results is not None and calibrated else ""

    def begin(request: Request | None) -> None:
        if request is not None:
            screen.show_tab(ISO9283)
            screen.start(work.verb_job(ISO9283_VERB, request))

    where = f", in {folder}" if workspace.folder is None else ""  # the first line of the screen shows an open run
    text = f"Drive to the test cube's poses{where}; {arms_words(workspace)}."
    if stale:
        text += f"\nThe model is not up to date: {stale}."
    cell = workspace.profile_path if workspace.folder is None else None  # a run has its own profile
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


def ask_certificate(screen: ScreenOfResults) -> None:
    """Ask for number and data, then write the certificate."""
    folder = screen.open_folder()
    if folder is None:
        return

    def begin(request: Request | None) -> None:
        if request is not None:
            screen.show_tab(CERTIFICATE)
            screen.start(work.verb_job(CERTIFICATE_VERB, request))

    text = f"{_certificate_words(screen.workspace)} Nothing moves."
    dialog = VerbQuestion(CERTIFICATE_VERB, text, _sent("Write", "w"), {"folder": folder})
    screen.app.push_screen(dialog, begin)


def ask_report(screen: ScreenOfResults) -> None:
    """Ask for page or page and PDF, then write."""
    if (calibrated := screen.calibrated_run()) is None:
        return
    folder, _, _ = calibrated

    def begin(answer: str | None) -> None:
        if answer in ("page", "pdf"):
            screen.start(work.job_of(REPORT, folder=folder, pdf=answer == "pdf"))

    text = f"Write report.html in {folder}; an installed Chromium prints it to report.pdf."
    screen.app.push_screen(Choice("Write the report?", text, _PAGES), begin)


def _sent(label: str, key: str) -> tuple[Answer, Answer]:
    """Return the answers to a question after which nothing moves."""
    return Answer("send", label, key, "success"), Answer("no", "Not now", "n")


def _certificate_words(workspace: Workspace) -> str:
    """Return what a person must know before a certificate is written."""
    complaints = () if workspace.overview is None else workspace.overview.complaints
    marks = f" OUT OF DATE: {'; '.join(complaints)}." if complaints else ""
    return f"What was measured in {workspace.folder}, judged by its tolerances; what was not given is named.{marks}"
