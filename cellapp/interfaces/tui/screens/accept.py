"""The screen Accept: the verdict on a run, the check of its calibration, ISO 9283, its certificate and its report.

The jobs of the screen Accept, with the questions before each.

The verbs of the screen Accept as jobs. Packages that a verb needs are loaded in the job's thread.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType

from cellapp.commands.certificate.request import VERB as CERTIFICATE_VERB
from cellapp.commands.check.request import STOPS
from cellapp.commands.check.request import VERB as CHECK_VERB
from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.commands.iso9283.request import VERB as ISO9283_VERB
from cellapp.commands.record import Verb
from cellapp.commands.report.request import VERB as REPORT
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, ISO_TESTS
from cellapp.ground.results import CALIBRATE, CERTIFICATE, CHECK, ISO9283, StageName
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.day_state import DayState
from cellapp.interfaces.tui.dialogs.question import ChosenAnswer
from cellapp.interfaces.tui.keys import bind, with_keys
from cellapp.interfaces.tui.screens.tabs import TabsScreen
from cellapp.interfaces.tui.widgets.controls import Line
from cellapp.interfaces.tui.widgets.parts_view import words_first
from cellapp.interfaces.tui.workspace import Workspace, new_folder

_SHOWN: tuple[tuple[Verb, StageName, str, str], ...] = (
    (CHECK_VERB, CHECK, "check", "Check"),
    (ISO9283_VERB, ISO9283, "measure", "ISO 9283"),
    (CERTIFICATE_VERB, CERTIFICATE, "export", "Certificate"),
)
"""Verbs that measure or state, their stages, the keys that do it again, and the tabs."""
_NOMINAL = "Tests by ISO 9283 with nominal commands need no calibration."


class AcceptScreen(TabsScreen):
    """Verdict, check, ISO 9283, certificate, report."""

    AUTO_FOCUS = "#tab-verdict PartsView"
    STEP: ClassVar[Step] = "accept"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "report", "Report", "write the page"),
        bind("check", "check", "Check", "does the calibration still hold? THE ARMS MOVE"),
        bind("measure", "iso9283", "ISO 9283", "measure by ISO 9283: THE ARMS MOVE"),
        bind("export", "certificate", "Certificate", "write the certificate; nothing moves"),
        bind("tab", "next_tab", "Next tab"),
    ]

    TABS: ClassVar[Mapping[str, str]] = {
        "Verdict": "Nothing is judged yet.",
        "Check": f"The calibration was not checked yet. {SHOWN['check']} measures a few stops: does it still hold?",
        "ISO 9283": f"Nothing was tested yet. {SHOWN['measure']} measures by ISO 9283: pose accuracy, repeatability,"
        " and more.",
        "Certificate": f"No certificate was written yet. {SHOWN['export']} writes it.",
    }

    def body(self) -> ComposeResult:
        yield Line(id="decision")
        yield Line(id="outdated")
        yield from super().body()

    # -- keys ----------------------------------------------------------------------------------------------------------

    def action_check(self) -> None:
        """Ask how many stops, then measure them against the calibration."""
        words = (
            "Drive to a few stops that tell most, and measure: does the calibration still hold? It ends as soon as it"
            " is sure; no model is changed;"
        )
        given = {"tracker_pose": None, "simulated_pose": None}
        if (calibrated := self.calibrated_run()) is not None:
            self.show_tab("Check")
            self.ask_verb(CHECK_VERB, words, {"folder": calibrated[0], **given}, proposed={"stops": STOPS})

    def action_iso9283(self) -> None:
        """Ask which tests, then make them in the open run, or else in a new run of the profile."""
        workspace = self.workspace
        profile = workspace.profile
        if profile is None:
            self.say(self.state.no_run, "warning")
            return
        folder = workspace.folder or new_folder(profile)
        commands = ISO_COMMANDS if workspace.stored(CALIBRATE) else ("nominal",)
        where = f", in {folder}" if workspace.folder is None else ""  # the first line of the screen shows an open run
        cell = workspace.profile_path if workspace.folder is None else None  # a run has its own profile
        tests = [test for test in ISO_TESTS if test != "cooperative" or len(profile.arms) > 1]
        self.show_tab("ISO 9283")
        self.ask_verb(
            ISO9283_VERB,
            f"Drive to the test cube's poses{where};",
            {"profile": cell, "folder": folder},
            proposed={"tests": ("pose",), "commands": commands},
            choices={"tests": tests, "commands": commands, "arms": tuple(profile.arms)},
        )

    def action_certificate(self) -> None:
        """Ask for number and data, then write the certificate."""
        if (folder := self.open_folder()) is not None:
            self.show_tab("Certificate")
            overview = self.workspace.overview
            late = f" OUT OF DATE: {'; '.join(overview.complaints)}." if overview and overview.complaints else ""
            text = f"What was measured in {folder}, judged by its tolerances; what was not given is named.{late}"
            write = ChosenAnswer("send", "Write", "w", "success"), ChosenAnswer("no", "Not now", "n")
            self.ask_verb(CERTIFICATE_VERB, f"{text} Nothing moves.", {"folder": folder}, write)

    def action_report(self) -> None:
        """Write the report of the open run."""
        if (calibrated := self.calibrated_run()) is not None:
            self.start(verb_jobs.job_of(REPORT, folder=calibrated[0]))

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_state(self, state: DayState) -> None:
        """Say why there is no result and no verdict."""
        busy = state.nothing(self.STEP, "") if state.job is not None and state.job.step == self.STEP else ""
        needs = {"Check": state.not_calibrated, "ISO 9283": "", "Certificate": state.no_run}
        for title, need in needs.items():
            self.tab(title).say_empty(busy or need or self.TABS[title])
        decision, sentence = "", state.no_run
        if self.workspace.verdict is not None:
            verdict, _ = self.workspace.verdict
            decision, sentence = verdict.state or "", f"{verdict.title}. {verdict.sentence}"
        if state.not_calibrated and not state.no_run:
            sentence = f"{state.not_calibrated} {_NOMINAL}"
        self.query_one("#decision", Line).say(sentence, decision.replace(" ", "-"))

    def show_run(self, workspace: Workspace) -> None:
        """Draw the content of the run."""
        marks = () if workspace.overview is None else workspace.overview.complaints
        outdated = self.query_one("#outdated", Line)
        outdated.say("\n".join(f"! OUT OF DATE: {with_keys(mark)}" for mark in marks))
        outdated.display = bool(marks)
        for verb, stage, key, title in _SHOWN:
            result = workspace.stored(stage)
            parts = () if result is None else verb.view(result).parts
            self.tab(title).show(words_first(parts), self.outdated(stage, key, "does it again"))
        self.tab("Verdict").show(() if workspace.verdict is None else workspace.verdict[1])
