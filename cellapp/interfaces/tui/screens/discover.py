"""The screen Discover: error after each step, effects with probabilities, pictures, what to check, proposed stops."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static, TabbedContent, TabPane

from cellapp.commands.collect.request import VERB as COLLECT
from cellapp.commands.discover import request
from cellapp.commands.discover.tables import discovery_tables
from cellapp.commands.discover.view import candidates_chart, explanation_text, gap_chart, picture_chart, proposal_lines
from cellapp.commands.discover.words import verdict_lines, verdict_sentence
from cellapp.commands.docs.keys import SHOWN
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.ground.counting import counted
from cellapp.ground.results import DISCOVER
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.confirmations import BEGIN, arms_words, offer_again
from cellapp.interfaces.tui.dialogs.question import Choice
from cellapp.interfaces.tui.keys import bind, with_keys
from cellapp.interfaces.tui.run_state import RunState
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView
from cellapp.interfaces.tui.workspace import Step, Workspace

_EMPTY = f"Nothing was searched yet: {SHOWN['go']} searches for missing effects."
_NO_PROPOSAL = f"No stops are proposed. {SHOWN['add']} proposes stops that best settle what these data leave open."
_PROPOSED = 20
"""Number of stops proposed at a time: about a quarter of an hour of measuring."""


class DiscoverScreen(DayScreen):
    """Search for missing effects; see what was found and what to do about it."""

    STEP: ClassVar[Step] = "discover"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "begin", "Discover", "search for missing effects; nothing moves"),
        bind("add", "propose", "Propose stops", "plan further stops that settle what is open; nothing moves"),
        bind("measure", "collect", "Collect them", "measure the proposed stops: THE ARMS MOVE"),
        bind("tab", "next_tab", "Next tab"),
    ]

    def body(self) -> ComposeResult:
        with TabbedContent(id="discovery"):
            with TabPane("Gap", id="gap"):
                yield PartsView(id="gap-parts")
            with TabPane("Names", id="names"):
                yield PartsView(id="name-tables")
            with TabPane("Pictures", id="pictures"):
                yield PartsView(id="effect-pictures")
            with TabPane("Check", id="check"), VerticalScroll():
                yield Static("", id="meaning", markup=False)
            with TabPane("Proposed stops", id="proposed"), VerticalScroll():
                yield Static(_NO_PROPOSAL, id="proposal", markup=False)

    # -- keys ----------------------------------------------------------------------------------------------------------

    def action_begin(self) -> None:
        """Search the open run."""
        if folder := self.open_folder():
            job = verb_jobs.job_of(request.VERB, folder=folder)
            offer_again(self, "Search again?", self._result, DISCOVER, partial(self.start, job))

    def action_propose(self) -> None:
        """Search, then plan further stops."""
        if folder := self.open_folder():
            job = verb_jobs.job_of(request.VERB, folder=folder, propose=_PROPOSED)
            title = "Search again, then propose stops?"
            offer_again(self, title, self._result, DISCOVER, partial(self.start, job))

    def action_collect(self) -> None:
        """Ask, then measure the planned stops that are not measured yet."""
        folder, todo = self.open_folder(), self.state.remaining
        if folder is None:
            return
        if todo == 0:
            self.say(f"No stop is left to measure: {SHOWN['add']} proposes further ones.", "warning")
            return
        text = f"{counted(todo, 'stop is', 'stops are')} left to measure in {folder}; {arms_words(self.workspace)}."

        def begin() -> None:
            self.start(verb_jobs.job_of(COLLECT, folder=folder, resume=True))
            self.cell_app.action_show("collect")

        self.ask(Choice("Collect?", text, BEGIN), begin)

    # -- drawing -------------------------------------------------------------------------------------------------------

    @property
    def _result(self) -> DiscoverResult | None:
        results = self.workspace.results
        return None if results is None else results.discover

    def show_run(self, workspace: Workspace) -> None:
        """Draw the discovery of the run."""
        found = self._result
        tables = self.query_one("#name-tables", PartsView)
        gap, pictures = self.query_one("#gap-parts", PartsView), self.query_one("#effect-pictures", PartsView)
        if found is None or workspace.results is None:
            tables.show([])
            gap.show(())
            pictures.show(())
            self.query_one("#proposal", Static).update(_NO_PROPOSAL)
        else:
            outdated = self.outdated(DISCOVER, "go", "searches again")
            tables.show((*discovery_tables(found), *verdict_lines(found)), outdated)
            self.query_one("#meaning", Static).update(with_keys(explanation_text(found)))
            proposal = _NO_PROPOSAL if found.proposal is None else with_keys("\n".join(proposal_lines(found.proposal)))
            self.query_one("#proposal", Static).update(proposal)
            verdicts = [f"Arm {name}: {arm.verdict}. {verdict_sentence(name, arm)}" for name, arm in found.arms.items()]
            charts = (chart(name, arm) for name, arm in found.arms.items() for chart in (gap_chart, candidates_chart))
            gap.show((*verdicts, *charts), outdated)
            pictures.show([picture_chart(name, one) for name, arm in found.arms.items() for one in arm.pictures])

    def show_state(self, state: RunState) -> None:
        """Say why there is no discovery, if none is stored."""
        if self._result is None:
            empty = state.nothing(self.STEP, _EMPTY)
            for view in self.query(PartsView):
                view.say_empty(empty)
            self.query_one("#meaning", Static).update(empty)
