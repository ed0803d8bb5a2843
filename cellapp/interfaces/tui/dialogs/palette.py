"""The command palette, with STOP in its corner."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.command import CommandPalette

from cellapp.commands.doctor.request import VERB as DOCTOR
from cellapp.commands.rehearse.request import VERB as REHEARSE
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.offers import offer_verb, offer_verb_of_profile, verbs_of_run
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.widgets.stop import StopCorner


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
    for key, active in screen.active_bindings.items():
        binding = active.binding
        own = isinstance(active.node, App | DayScreen) and not binding.system
        hidden = binding.action == "command_palette" or binding.action.startswith("show(")
        if own and active.enabled and not hidden:
            run = partial(app.run_action, binding.action, active.node)
            yield SystemCommand(binding.description, binding.tooltip or f"key {key}", run)
    for verb in (DOCTOR, REHEARSE):
        yield SystemCommand(f"cellapp {verb.name}", verb.summary, partial(offer_verb_of_profile, screen, verb))
    for verb in verbs_of_run():
        yield SystemCommand(f"cellapp {verb.name}", verb.summary, partial(offer_verb, screen, verb))
