"""The screen Accept: the verdict on a run, the check of its calibration, ISO 9283, its certificate and its report.

The jobs of the screen Accept, with the questions before each.

The verbs of the screen Accept as jobs. Packages that a verb needs are loaded in the job's thread.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from textual import work as in_thread
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.widgets import Static, TabbedContent, TabPane
from textual.worker import get_current_worker

from cellapp.commands.certificate.request import VERB as CERTIFICATE_VERB
from cellapp.commands.check.request import STOPS
from cellapp.commands.check.request import VERB as CHECK_VERB
from cellapp.commands.docs.keys import SHOWN
from cellapp.commands.iso9283.request import VERB as ISO9283_VERB
from cellapp.commands.report.request import VERB as REPORT
from cellapp.commands.run_results import RunResults
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS
from cellapp.ground.results import CERTIFICATE, CHECK, ISO9283, StageName
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.confirmations import BEGIN, USE_STALE, arms_words, ask_of_calibrated
from cellapp.interfaces.tui.dialogs.question import ChosenAnswer
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.interfaces.tui.keys import bind, with_keys
from cellapp.interfaces.tui.run_state import COPY_IT, RunState
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView, words_first
from cellapp.interfaces.tui.workspace import Step, Workspace, new_folder

if TYPE_CHECKING:
    from cellapp.commands.report.summary import RunVerdict
    from cellapp.commands.view.parts import Parts


def verdict(folder: Path) -> RunVerdict | None:
    """Read judgements, marks and next steps of a run; None if it cannot be read. Call it in a separate thread."""
    from datetime import UTC, datetime

    from cellapp.cell.run import RunFile
    from cellapp.commands.report.summary import read_verdict
    from cellapp.ground.errors import CellappError

    try:
        with RunFile.open(folder) as run:
            return read_verdict(run, datetime.now(UTC).date())
    except (CellappError, OSError, ValueError, TypeError):  # the last three: values of a damaged or foreign file
        return None  # the message line says what is wrong with the run


_NOT_JUDGED = "Nothing is judged yet."
_NOT_CHECKED = f"The calibration was not checked yet. {SHOWN['check']} measures a few stops: does it still hold?"
_NOT_TESTED = (
    f"Nothing was tested yet. {SHOWN['measure']} measures by ISO 9283: pose accuracy, repeatability, and more."
)
_NO_CERTIFICATE = f"No certificate was written yet. {SHOWN['export']} writes it."
_READING = "reading the run ..."
_NOMINAL = "Tests by ISO 9283 with nominal commands need no calibration."
_UNREADABLE = "The run cannot be judged; the message line says what is wrong with it."


class AcceptScreen(DayScreen):
    """Verdict, check, ISO 9283, certificate, report."""

    AUTO_FOCUS = "#verdict-tables"
    STEP: ClassVar[Step] = "accept"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "report", "Report", "write the page"),
        bind("check", "check", "Check", "does the calibration still hold? THE ARMS MOVE"),
        bind("measure", "iso9283", "ISO 9283", "measure by ISO 9283: THE ARMS MOVE"),
        bind("export", "certificate", "Certificate", "write the certificate; nothing moves"),
        bind("tab", "next_tab", "Next tab"),
    ]

    def body(self) -> ComposeResult:
        yield Static("", id="decision", markup=False)
        yield Static("", id="outdated", markup=False)
        with TabbedContent(id="accept"):
            with TabPane("Verdict", id="verdict-pane"):
                yield PartsView(_NOT_JUDGED, id="verdict-tables")
            with TabPane("Check", id="check-pane"):
                yield PartsView(id="check-tables")
            with TabPane("ISO 9283", id="iso9283-pane"):
                yield PartsView(id="iso9283-tables")
            with TabPane("Certificate", id="certificate-pane"):
                yield PartsView(id="certificate-tables")

    # -- keys ----------------------------------------------------------------------------------------------------------

    def action_check(self) -> None:
        """Ask how many stops, then measure them against the calibration."""
        words = (
            "Drive to a few stops that tell most, and measure: does the calibration still hold? It ends as soon as it"
            " is sure; no model is changed;"
        )
        given = {"tracker_pose": None, "simulated_pose": None}
        if ask_of_calibrated(self, CHECK_VERB, words, given, {"stops": STOPS}):
            self.show_tab(CHECK)

    def action_iso9283(self) -> None:
        """Ask which tests, then make them in the open run, or else in a new run of the profile."""
        workspace = self.workspace
        profile, results = workspace.profile, workspace.results
        if profile is None:
            self.say(self.state.no_run, "warning")
            return
        folder = workspace.folder or new_folder(profile)
        calibrated = results is not None and results.calibrate is not None
        commands = ISO_COMMANDS if calibrated else ("nominal",)
        stale = workspace.stale
        where = f", in {folder}" if workspace.folder is None else ""  # the first line of the screen shows an open run
        text = f"Drive to the test cube's poses{where}; {arms_words(workspace)}."
        if stale:
            text += f"\nThe model is not up to date: {stale}."
        cell = workspace.profile_path if workspace.folder is None else None  # a run has its own profile
        tests = [test for test in ISO_TESTS if test != "cooperative" or len(profile.arms) > 1]
        self.show_tab(ISO9283)
        self.ask_verb(
            VerbQuestion(
                ISO9283_VERB,
                text,
                USE_STALE if stale else BEGIN,
                {"profile": cell, "folder": folder, "out_of_date": bool(stale)},
                proposed={"tests": ("pose",), "commands": commands},
                choices={"tests": tests, "commands": commands, "arms": tuple(profile.arms)},
            )
        )

    def action_certificate(self) -> None:
        """Ask for number and data, then write the certificate."""
        if (folder := self.open_folder()) is not None:
            self.show_tab(CERTIFICATE)
            overview = self.workspace.overview
            late = f" OUT OF DATE: {'; '.join(overview.complaints)}." if overview and overview.complaints else ""
            text = f"What was measured in {folder}, judged by its tolerances; what was not given is named.{late}"
            write = ChosenAnswer("send", "Write", "w", "success"), ChosenAnswer("no", "Not now", "n")
            self.ask_verb(VerbQuestion(CERTIFICATE_VERB, f"{text} Nothing moves.", write, {"folder": folder}))

    def action_report(self) -> None:
        """Write the report of the open run."""
        if (calibrated := self.calibrated_run()) is not None:
            self.start(verb_jobs.job_of(REPORT, folder=calibrated[0]))

    def tab_shown(self, tabs: TabbedContent) -> None:
        """Focus the tables of the tab."""
        self._scroll(tabs.active)

    def show_tab(self, stage: StageName) -> None:
        """Show the tab of a stage."""
        self.query_one("#accept", TabbedContent).active = f"{stage}-pane"
        self._scroll(f"{stage}-pane")

    def _scroll(self, pane: str) -> None:
        """Let the keys scroll the tables of a tab."""
        self.call_after_refresh(self.query_one(f"#{pane}").query_one(PartsView).focus)

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_state(self, state: RunState) -> None:
        """Say why there is no result and no verdict."""
        for place, empty in (("check", _NOT_CHECKED), ("iso9283", _NOT_TESTED), ("certificate", _NO_CERTIFICATE)):
            needs = state.no_run if place == "certificate" else state.not_calibrated if place == "check" else ""
            busy = state.nothing(self.STEP, "") if state.job is not None and state.job.step == self.STEP else ""
            locked = COPY_IT if state.read_only else ""
            self.query_one(f"#{place}-tables", PartsView).say_empty(busy or needs or locked or empty)
        if state.no_run:
            self._draw_verdict(None, state.no_run)
        elif state.not_calibrated:
            self._draw_decision("", f"{state.not_calibrated} {_NOMINAL}")

    def show_run(self, workspace: Workspace) -> None:
        """Draw the content of the run, and judge it in a thread."""
        marks = () if workspace.overview is None else workspace.overview.complaints
        outdated = self.query_one("#outdated", Static)
        outdated.update("\n".join(f"! OUT OF DATE: {with_keys(mark)}" for mark in marks))
        outdated.display = bool(marks)
        self._draw_measured(workspace.results)
        if workspace.folder is None:
            self._draw_verdict(None, self.state.no_run)
        else:
            self._draw_decision("", _READING)
            self._judge(workspace)

    @in_thread(thread=True, exclusive=True, group="verdict")
    def _judge(self, workspace: Workspace) -> None:
        assert workspace.folder is not None
        read = verdict(workspace.folder)
        if not get_current_worker().is_cancelled:  # else another run is being read
            self.call_later(self._show_verdict, workspace, read)

    def _show_verdict(self, workspace: Workspace, verdict: RunVerdict | None) -> None:
        """Draw the judgements, unless another workspace was opened meanwhile."""
        if workspace is self._shown:
            self._draw_verdict(verdict, _UNREADABLE)

    def _draw_verdict(self, verdict: RunVerdict | None, why_not: str) -> None:
        from cellapp.commands.report.summary import verdict_sentences, verdict_tables

        tables = self.query_one("#verdict-tables", PartsView)
        if verdict is None:
            self._draw_decision("", why_not)
            tables.show([])
            return
        needs = self.state.not_calibrated
        words = f"{needs} {_NOMINAL}" if needs else f"{verdict.title}. {verdict.sentence}"
        self._draw_decision(verdict.state or "", words)
        tables.show((*verdict_tables(verdict), *verdict_sentences(verdict)))

    def _draw_decision(self, state: str, sentence: str) -> None:
        decision = self.query_one("#decision", Static)
        decision.update(sentence)
        decision.set_classes(state.replace(" ", "-"))

    def _draw_measured(self, results: RunResults | None) -> None:
        check, tests, certificate = (
            (None, None, None) if results is None else (results.check, results.iso9283, results.certificate)
        )
        self._draw_stage(CHECK, "check", () if check is None else CHECK_VERB.view(check).parts)
        self._draw_stage(ISO9283, "measure", () if tests is None else ISO9283_VERB.view(tests).parts)
        self._draw_stage(CERTIFICATE, "export", () if certificate is None else CERTIFICATE_VERB.view(certificate).parts)

    def _draw_stage(self, stage: StageName, again: str, parts: Parts) -> None:
        """Draw a result, below a mark if it is out of date."""
        outdated = self.outdated(stage, again, "does it again")
        self.query_one(f"#{stage}-tables", PartsView).show(words_first(parts), outdated)
