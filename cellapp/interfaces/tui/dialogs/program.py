"""The command palette, with STOP in its corner.

Permission for the first motion of real arms.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.command import CommandPalette
from textual.containers import Container
from textual.widgets import Input, Static

from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.rehearse.request import VERB as REHEARSE
from cellapp.interfaces.tui.confirmations import offer_verb, verbs_of_run
from cellapp.interfaces.tui.dialogs.question import AnswerQuestion, ChosenAnswer
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.keys import step_of
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.controls import StopButton


class Palette(CommandPalette):
    """Every action of the application, found by a few letters of its name. F10 closes it, as all dialogs."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("f10", "escape", show=False)]

    def compose(self) -> ComposeResult:
        yield Container(StopButton(), classes="corner")
        yield from super().compose()


def possible_commands(app: Host, screen: DayScreen) -> Iterator[SystemCommand]:
    """Yield every possible action of the application and of a screen, for the command palette."""
    for entry in SCREENS:
        show = partial(app.action_show, entry.step)
        yield SystemCommand(f"Show {entry.title}", f"{entry.purpose} (key {entry.key})", show)
    listed = set[str]()  # an action with two keys is one command
    for key, active in screen.active_bindings.items():
        binding = active.binding
        own = isinstance(active.node, App | DayScreen) and not binding.system
        hidden = binding.action == "command_palette" or binding.action.startswith("show(")
        if own and active.enabled and not hidden and binding.description and binding.action not in listed:
            listed.add(binding.action)
            run = partial(app.run_action, binding.action, active.node)
            yield SystemCommand(binding.description, binding.tooltip or f"key {key}", run)
    for verb in (DOCTOR, REHEARSE, *verbs_of_run()):
        if step_of(verb.name) != screen.STEP:  # there a key does it, and is listed above
            yield SystemCommand(f"cellapp {verb.name}", verb.summary, partial(offer_verb, screen, verb))


class MotionQuestion(AnswerQuestion[bool]):
    """Show the first motion of real arms in words; a person types the profile's name to allow it.

    Parameters
    ----------
    words : str
        The first motion.
    name : str
        The name to type.
    """

    AUTO_FOCUS = "#name"

    def __init__(self, words: str, name: str) -> None:
        refuse = ChosenAnswer("refuse", "Do not move", "escape", "error")
        super().__init__("REAL ARMS WILL MOVE. Is the cell clear?", words, (refuse,))
        self._profile_name = name

    def fields(self) -> ComposeResult:
        yield Static(f"Type '{self._profile_name}' and Enter to let them move.", markup=False)
        yield Input(id="name", compact=True)

    def entered(self) -> None:
        """Allow the motion if the name is correct, else ask again."""
        if self.typed("name") == self._profile_name:
            self.dismiss(True)
        else:
            self.explain(f"That is not '{self._profile_name}'. Type it, or press Escape.")

    def action_answer(self, value: str) -> None:
        """Close the question: nothing moves."""
        self.dismiss(False)
