"""The screen Discover: what was found with its evidence and pictures, what to check, proposed stops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import BindingType

from cellapp.commands.collect.request import VERB as COLLECT
from cellapp.commands.discover import request
from cellapp.commands.discover.view import found_parts, proposal_parts
from cellapp.commands.docs.keys import SHOWN, Step
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.ground.counting import counted
from cellapp.ground.results import DISCOVER
from cellapp.interfaces.tui import verb_jobs
from cellapp.interfaces.tui.confirmations import offer_again
from cellapp.interfaces.tui.dialogs.question import BEGIN, Choice
from cellapp.interfaces.tui.keys import bind
from cellapp.interfaces.tui.screens.tabs import TabsScreen
from cellapp.interfaces.tui.widgets.parts_view import PartsView
from cellapp.interfaces.tui.workspace import Workspace

_NO_PROPOSAL = f"No stops are proposed. {SHOWN['add']} proposes stops that best settle what these data leave open."
_PROPOSED = 20
"""Number of stops proposed at a time: about a quarter of an hour of measuring."""


class DiscoverScreen(TabsScreen):
    """Search for missing effects; see what was found and what to do about it."""

    STEP: ClassVar[Step] = "discover"
    BINDINGS: ClassVar[list[BindingType]] = [
        bind("go", "begin", "Discover", "search for missing effects; nothing moves"),
        bind("add", "propose", "Propose stops", "plan further stops that settle what is open; nothing moves"),
        bind("measure", "collect", "Collect them", "measure the proposed stops: THE ARMS MOVE"),
        bind("tab", "next_tab", "Next tab"),
    ]

    TABS: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("Found", "Proposed stops"), f"Nothing was searched yet: {SHOWN['go']} searches for missing effects."
    )

    def in_tab(self, title: str) -> ComposeResult:
        """Empty until it is known whether the run was searched."""
        yield PartsView()

    # -- keys ----------------------------------------------------------------------------------------------------------

    def action_begin(self) -> None:
        """Search the open run."""
        if folder := self.open_folder():
            offer_again(self, "Search again?", DISCOVER, verb_jobs.job_of(request.VERB, folder=folder))

    def action_propose(self) -> None:
        """Search, then plan further stops."""
        if folder := self.open_folder():
            job = verb_jobs.job_of(request.VERB, folder=folder, propose=_PROPOSED)
            offer_again(self, "Search again, then propose stops?", DISCOVER, job)

    def action_collect(self) -> None:
        """Ask, then measure the planned stops that are not measured yet."""
        folder, todo = self.open_folder(), self.state.remaining
        if folder is None:
            return
        if todo == 0:
            self.say(f"No stop is left to measure: {SHOWN['add']} proposes further ones.", "warning")
            return
        text = f"{counted(todo, 'stop is', 'stops are')} left to measure in {folder}; {self.workspace.arms_words}."

        def begin() -> None:
            self.start(verb_jobs.job_of(COLLECT, folder=folder, resume=True))
            self.cell_app.action_show("collect")

        self.ask(Choice("Collect?", text, BEGIN), begin)

    # -- drawing -------------------------------------------------------------------------------------------------------

    def show_run(self, workspace: Workspace) -> None:
        """Draw the discovery of the run."""
        found: DiscoverResult | None = workspace.stored(DISCOVER)
        if found is None:
            self.show_nothing()
            return
        self.tab("Found").show(found_parts(found), self.outdated(DISCOVER, "go", "searches again"))
        proposal = [_NO_PROPOSAL] if found.proposal is None else proposal_parts(found.proposal)
        self.tab("Proposed stops").show(proposal)
