"""The STOP button in the upper right corner of every screen and every dialog."""

from __future__ import annotations

from typing import cast

from textual.app import ComposeResult
from textual.containers import Container
from textual.events import Click
from textual.widgets import Static

from cellapp.interfaces.tui.host import Host


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


class StopCorner(Container):
    """The corner of a dialog with STOP, at the same position as on all screens."""

    def compose(self) -> ComposeResult:
        yield StopButton()
