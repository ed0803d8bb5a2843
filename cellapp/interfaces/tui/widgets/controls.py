"""The STOP button in the upper right corner of every screen and every dialog.

A dialog field with its label.

The keys that are possible now, at the bottom of every screen; a click has the effect of the key.

Textual's own footer has a widget for each key and recreates all of them whenever a key becomes possible: 60 ms of a
screen switch, measured with Textual 8.2. This one is a single text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from rich.cells import cell_len
from textual.containers import Horizontal
from textual.content import Content
from textual.events import Click, Mount
from textual.screen import Screen
from textual.style import Style
from textual.suggester import SuggestFromList
from textual.widget import Widget
from textual.widgets import Checkbox, Input, Static

from cellapp.interfaces.tui.host import Host


class Line(Static):
    """A text that is drawn only when it changes: what is drawn takes the time in which keys wait."""

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__("", id=id, classes=classes, markup=False)
        self._said: tuple[object, ...] = ("", None, None)

    def say(self, text: str | Content, classes: str | None = None) -> None:
        """Show a text, with these classes if they are given."""
        said = (str(text), text.spans if isinstance(text, Content) else None, classes)
        if said != self._said:
            self.update(text)
            if classes is not None:
                self.set_classes(classes)
            self._said = said


class StopButton(Static):
    """Button that brakes all arms when pressed with the mouse; the keys Escape and Ctrl-C do the same.

    It takes no focus, so that Enter, pressed for something else, never stops a job by accident, and Tab skips it. It
    reacts to the press of the mouse button, not to its release.
    """

    def __init__(self) -> None:
        super().__init__(" STOP  Esc ", classes="stop", markup=False)
        self.tooltip = "Brake all arms now. Escape and Ctrl-C do the same."

    def on_resize(self) -> None:
        """Store its position, for presses that are handled before the event loop gets them."""
        cast(Host, self.app).presses.region = self.region

    async def on_mouse_down(self) -> None:
        """Brake."""
        await self.run_action("app.stop_job")

    def on_click(self, event: Click) -> None:
        """Consume the click of a handled press: a dialog below must not get it."""
        event.stop()


class Labelled(Horizontal):
    """One line: a label and a field."""

    def __init__(self, label: str, field: Widget) -> None:
        super().__init__(Static(label, markup=False), field)


class Box(Checkbox):
    """A check box that is empty until it is ticked, so that its state is visible without colours."""

    def render(self) -> Content:
        """Return the mark and the label."""
        self.BUTTON_INNER = "X" if self.value else " "
        return super().render()


def text_field(label: str, name: str, text: str = "", hint: str = "", *, choices: Sequence[str] = ()) -> Labelled:
    """Return a text field with its label.

    Parameters
    ----------
    label, name : str
        Text before the field; its id.
    text, hint : str
        Initial text; text that is shown while the field is empty.
    choices : sequence of str
        Texts that the right arrow completes.
    """
    suggester = SuggestFromList(choices) if choices else None
    return Labelled(label, Input(text, id=name, compact=True, placeholder=hint, suggester=suggester))


class KeyLine(Static):
    """Keys and their effects, in as many lines as they need, at most two."""

    def __init__(self) -> None:
        super().__init__("", markup=False)
        self._shown: tuple[Entry, ...] = ()

    def on_mount(self, event: Mount) -> None:
        """Subscribe to changes of the possible keys."""
        self.screen.bindings_updated_signal.subscribe(self, self._change)

    def _change(self, screen: Screen[object]) -> None:
        if self.is_attached and screen is self.screen and self.app.screen is screen:
            self.call_after_refresh(self._draw)

    def on_resize(self) -> None:
        """Lay the keys out again."""
        self._lay_out()

    def _draw(self) -> None:
        keys: dict[str, Entry] = {}
        for active in self.screen.active_bindings.values():
            binding = active.binding
            if not binding.show or not active.enabled or binding.system:
                continue
            target = {self.app: "app.", self.screen: "screen."}.get(active.node, "")
            key, action = self.app.get_key_display(binding), f"{target}{binding.action}" if target else ""
            entry = Entry(key, binding.description, action, general=active.node is self.app)
            keys.setdefault(binding.action, entry)
        shown = tuple(sorted(keys.values(), key=lambda entry: entry.general))
        if shown != self._shown:
            self._shown = shown
            self._lay_out()

    def _lay_out(self) -> None:
        lines = key_lines(self._shown, self.size.width or self.app.size.width)
        drawn = [Content.assemble(*(part for entry in line for part in entry.parts)) for line in lines]
        self.update(Content("\n").join(drawn))


@dataclass(frozen=True)
class Entry:
    """A key, its effect, the action of a click; ``general`` entries are the same on every screen."""

    key: str
    words: str
    action: str
    general: bool = False

    @property
    def width(self) -> int:
        """Width of the entry in cells."""
        return cell_len(self.key) + cell_len(self.words) + 4

    @property
    def parts(self) -> tuple[tuple[str, Style], ...]:
        """Key and words; a click on either runs the action."""
        click = Style.from_meta({"@click": self.action}) if self.action else Style.null()
        return (f" {self.key}", click + Style(bold=True)), (f" {self.words}  ", click)


def key_lines(entries: Sequence[Entry], width: int, most: int = 2) -> list[list[Entry]]:
    """Distribute entries over lines without breaking any. If not all fit, the last ones of the screen are omitted."""
    shown = list(entries)
    while True:
        lines: list[list[Entry]] = [[]]
        for entry in shown:
            if lines[-1] and sum(one.width for one in lines[-1]) + entry.width > width:
                lines.append([])
            lines[-1].append(entry)
        if len(lines) <= most or len(shown) == 1:
            return lines[:most]
        own = [place for place, entry in enumerate(shown) if not entry.general]
        shown.pop(own[-1] if own else 0)
