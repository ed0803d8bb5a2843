"""Ask which path file is followed, by which arm, and whether the arms move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Checkbox, Input, Static

from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.write_question import WriteQuestion
from cellapp.interfaces.tui.widgets.labelled import Labelled, text_field

if TYPE_CHECKING:
    from cellapp.commands.follow.run import Driving

_YAML = (".yaml", ".yml")


@dataclass(frozen=True)
class FollowRequest:
    """What ``follow`` is asked for; see ``follow_run``. ``csv`` is None where no joint positions are written."""

    paths: Path
    arm: str | None
    driving: Driving
    csv: Path | None
    rehearse: bool = False
    out_of_date: bool = False


class FollowPath(WriteQuestion[FollowRequest]):
    """Ask how paths are followed. Returns the request; None where the dialog is closed.

    Parameters
    ----------
    proposed : str
        Path file, empty for none.
    arms : sequence of str
    arms_words : str
        Which arms would move.
    stale : str
        Why the model is out of date; empty if it is not.
    """

    def __init__(self, proposed: str, arms: Sequence[str], arms_words: str, stale: str) -> None:
        super().__init__()
        self._proposed, self._arms, self._words, self._stale = proposed, tuple(arms), arms_words, stale

    def body(self) -> ComposeResult:
        yield Static("Follow paths", classes="title", markup=False)
        yield Labelled("path file", PathField(self._proposed, lambda path: path.suffix in _YAML))
        yield text_field("only arm", "arm", hint="empty: all of them", choices=self._arms)
        yield text_field("joint positions", "csv", hint="CSV file to write; may be empty")
        yield Checkbox(f"drive: {self._words}", id="drive", compact=True)
        yield Checkbox("drive and measure: how far the SMR is from the path", id="verify", compact=True)
        yield Checkbox("rehearse: drive once before, correct by how the joints lag", id="rehearse", compact=True)
        if self._stale:
            yield Static(f"The model is not up to date: {self._stale}.", classes="text", markup=False)
        note = f"Without a mark nothing moves. {self.closing_key} closes; real arms ask again before the first motion."
        yield Static(note, classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Begin (Ctrl+S)", id="write", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Begin with the file."""
        self.query_one("#path", Input).focus()

    def action_send(self) -> None:
        """Close with the request; the verb judges it."""
        paths, arm, csv = (self.typed(name) for name in ("path", "arm", "csv"))
        marks = (self.query_one(f"#{name}", Checkbox).value for name in ("drive", "verify", "rehearse"))
        drive, verify, rehearse = marks
        if not paths:
            self.query_one("#path").focus()
            return
        driving: Driving = "verify" if verify else "drive" if drive else "plan"
        written = Path(csv).expanduser() if csv else None
        request = FollowRequest(Path(paths).expanduser(), arm or None, driving, written, rehearse, bool(self._stale))
        self.dismiss(request)
