"""The keys that are possible now, at the bottom of every screen; a click does what the key does.

Textual's own footer makes a widget of each key and makes all of them anew whenever a key becomes possible: 60 ms of a
switch of screens, measured with Textual 8.2. This one is a single text.
"""

from __future__ import annotations

from textual.content import Content
from textual.events import Mount
from textual.screen import Screen
from textual.style import Style
from textual.widgets import Static


class KeyLine(Static):
    """Keys and what they do, in as many lines as they need, at most two."""

    DEFAULT_CSS = """
    KeyLine {
        dock: bottom; height: auto; max-height: 2; width: 1fr;
        background: $footer-background; color: $footer-foreground;
        link-style: none; link-color: $footer-foreground; link-background: $footer-background;
    }
    """

    def __init__(self) -> None:
        super().__init__("", markup=False)
        self._shown: tuple[tuple[str, str, str], ...] = ()

    def on_mount(self, event: Mount) -> None:
        """Listen to changes of what is possible."""
        self.screen.bindings_updated_signal.subscribe(self, self._change)

    def _change(self, screen: Screen[object]) -> None:
        if self.is_attached and screen is self.screen and self.app.screen is screen:
            self.call_after_refresh(self._draw)

    def _draw(self) -> None:
        keys: dict[str, tuple[str, str, str]] = {}
        for active in self.screen.active_bindings.values():
            binding = active.binding
            if not binding.show or not active.enabled or binding.system:
                continue
            target = {self.app: "app.", self.screen: "screen."}.get(active.node, "")
            key = self.app.get_key_display(binding)
            keys.setdefault(binding.action, (key, binding.description, f"{target}{binding.action}" if target else ""))
        shown = tuple(keys.values())
        if shown != self._shown:
            self._shown = shown
            self.update(Content.assemble(*(part for entry in shown for part in _parts(*entry))))


def _parts(key: str, description: str, action: str) -> tuple[tuple[str, Style] | str, ...]:
    """A key and its description; both do the action when they are clicked."""
    click = Style.from_meta({"@click": action}) if action else Style.null()
    return (f" {key}", click + Style(bold=True)), (f" {description} ".replace(" ", "\N{NO-BREAK SPACE}"), click), " "
