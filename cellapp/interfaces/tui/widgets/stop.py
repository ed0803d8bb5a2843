"""The STOP button in the upper right corner of every screen and every dialog."""

from __future__ import annotations

from typing import cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.events import Click
from textual.widgets import Static

from cellapp.interfaces.tui.host import Host


class StopButton(Static):
    """Brakes all arms when it is pressed with the mouse; the keys Escape and Ctrl-C do the same.

    It takes no focus, so that Enter, pressed for something else, never stops a job by accident, and Tab does not pass
    it. It reacts to the press of the mouse button, not to its release.
    """

    def __init__(self) -> None:
        super().__init__(" STOP  Esc ", classes="stop", markup=False)
        self.tooltip = "Brake all arms now. Escape and Ctrl-C do the same."

    def on_resize(self) -> None:
        """Say where it is, for presses that are seen before the event loop gets them."""
        cast(Host, self.app).presses.region = self.region

    async def on_mouse_down(self) -> None:
        """Brake."""
        await self.run_action("app.stop_job")

    def on_click(self, event: Click) -> None:
        """The press was handled; a dialog below must not take the click."""
        event.stop()


class StopCorner(Container):
    """The corner of a dialog that holds STOP, where all screens have it."""

    def compose(self) -> ComposeResult:
        yield StopButton()
