"""Ask before the tracker's new station is measured."""

from __future__ import annotations

from dataclasses import dataclass

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Static

from cellapp.interfaces.tui.dialogs.question import FieldsQuestion
from cellapp.interfaces.tui.widgets.labelled import text_field

POINTS = 4
"""As ``cellapp.commands.locate.run`` has it, which loads more than a dialog needs."""


@dataclass(frozen=True)
class LocateRequest:
    """What ``locate`` is asked for; see ``locate_run``. Poses are what a person typed; None for nothing."""

    points: int
    tracker_pose: str | None
    simulated_pose: str | None


class LocateTracker(FieldsQuestion[LocateRequest]):
    """Ask how the tracker is located. Returns the request; None where the dialog is closed.

    Parameters
    ----------
    arms : str
        Which arms move, in words.
    simulated : bool
        Whether the cell is simulated: its tracker can be put elsewhere first.
    stale : str
        Why the model should not be used as it is; empty if it holds.
    """

    def __init__(self, arms: str, *, simulated: bool, stale: str) -> None:
        super().__init__()
        self._arms, self._simulated, self._stale = arms, simulated, stale

    def body(self) -> ComposeResult:
        yield Static("Locate the tracker?", classes="title", markup=False)
        text = f"After the tracker was moved: drive to a few points and measure where it stands now; {self._arms}."
        if self._stale:
            text += f"\nThe model is not up to date: {self._stale}."
        yield Static(text, classes="text", markup=False)
        yield text_field("points", "points", str(POINTS), "of all arms together")
        yield text_field("tracker about at", "tracker-pose", hint="x,y,z,r,p,y in m, deg; empty: as before")
        if self._simulated:
            yield text_field("put it first to", "simulated-pose", hint="x,y,z,r,p,y in m, deg; may be empty")
        yield Static(f"Enter begins, {self.closing_key} closes.", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Begin", id="begin", variant="success", compact=True)
            yield Button("Not now", id="no", compact=True)

    def on_mount(self) -> None:
        """Begin with the number of points."""
        self.query_one("#points").focus()

    def action_send(self) -> None:
        """Close with what was typed; the verb judges the poses."""
        points = self.typed("points")
        if not (points.isascii() and points.isdigit()):
            self.explain(f"Type how many points, as {POINTS}.")
            return
        simulated = self.typed("simulated-pose") if self._simulated else ""
        self.dismiss(LocateRequest(int(points[:6]), self.typed("tracker-pose") or None, simulated or None))
