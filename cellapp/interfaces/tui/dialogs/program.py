"""The command palette, with STOP in its corner.

Permission for the first motion of real arms.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

from textual import on
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.command import CommandPalette
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.rehearse.request import VERB as REHEARSE
from cellapp.interfaces.tui.confirmations import offer_verb, offer_verb_of_profile, verbs_of_run
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.keys import step_of
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.controls import StopCorner


class Palette(CommandPalette):
    """Every action of the application, found by a few letters of its name. F10 closes it, as all dialogs."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("f10", "escape", show=False)]

    def compose(self) -> ComposeResult:
        yield StopCorner()
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
    of_profile = ((verb, offer_verb_of_profile) for verb in (DOCTOR, REHEARSE))
    for verb, offer in (*of_profile, *((verb, offer_verb) for verb in verbs_of_run())):
        if step_of(verb.name) != screen.STEP:  # there a key does it, and is listed above
            yield SystemCommand(f"cellapp {verb.name}", verb.summary, partial(offer, screen, verb))


class MotionQuestion(Question[bool]):
    """Show the first motion of real arms in words; a person types the profile's name to allow it.

    Parameters
    ----------
    words : str
        The first motion.
    name : str
        The name to type.
    """

    def __init__(self, words: str, name: str) -> None:
        super().__init__()
        self._words, self._profile_name = words, name

    def body(self) -> ComposeResult:
        yield Static("REAL ARMS WILL MOVE. Is the cell clear?", markup=False, classes="title danger")
        yield Static(self._words, markup=False, classes="text")
        yield Static(f"Type '{self._profile_name}' and Enter to let them move.", markup=False, id="asked")
        yield Input(id="name", compact=True)
        with Horizontal(classes="answers"):
            yield Button("Do not move (Esc)", id="refuse", variant="error", compact=True)

    def on_mount(self) -> None:
        """Focus the field."""
        self.query_one("#name").focus()

    @on(Input.Submitted)
    def check_name(self, event: Input.Submitted) -> None:
        """Allow the motion if the name is correct, else ask again."""
        event.stop()
        if event.value.strip() == self._profile_name:
            self.dismiss(True)
        else:
            self.query_one("#asked", Static).update(f"That is not '{self._profile_name}'. Type it, or press Escape.")

    @on(Button.Pressed)
    def refuse(self, event: Button.Pressed) -> None:
        """Close the question: nothing moves."""
        event.stop()
        self.dismiss(False)
