"""Dialog for external readings and what is known of them, to create a profile and a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Static

from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.question import FieldsQuestion
from cellapp.interfaces.tui.widgets.controls import Labelled, text_field

RUNS = "logs"


@dataclass(frozen=True)
class OwnReadingsRequest:
    """Request for ``init --readings`` and ``import``; empty texts are found out. ``run`` is a new folder."""

    readings: Path
    arm: str
    angles: Literal["rad", "deg", ""]
    lengths: Literal["m", "mm", ""]
    run: Path


class OwnReadings(FieldsQuestion[OwnReadingsRequest]):
    """Dialog for external readings. Returns the request; None if the dialog is closed.

    Parameters
    ----------
    home : Path
        Folder that contains the folders of profiles and runs.
    """

    def __init__(self, home: Path) -> None:
        super().__init__()
        self._home = home

    def body(self) -> ComposeResult:
        yield Static("Calibrate readings that were recorded elsewhere", classes="title", markup=False)
        text = (
            "A text file with a row of names, joint positions and points. Separators, decimal commas and units are"
            " found out. A profile and a run are written; nothing moves."
        )
        yield Static(text, classes="text", markup=False)
        yield Labelled("readings", PathField("", _is_table, id="readings", hint="CSV or text"))
        yield text_field("arm", "arm", hint="name of an arm type, its file, or D-H rows; empty: which would fit?")
        yield text_field("joint positions in", "angles", hint="rad or deg; empty: found out")
        yield text_field("points in", "lengths", hint="m or mm; empty: found out")
        yield text_field("new run", "run", hint="empty: named after the file")
        yield Static(f"Enter begins, {self.closing_key} closes.", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Begin", id="begin", variant="success", compact=True)
            yield Button("Not now", id="no", compact=True)

    def on_mount(self) -> None:
        """Focus the file field."""
        self.query_one("#readings").focus()

    def action_send(self) -> None:
        """Close with the typed values if the units are valid; the verb checks the rest."""
        readings, angles, lengths = self.typed("readings"), self.typed("angles"), self.typed("lengths")
        if not readings:
            self.explain("Type the file of the readings.")
        elif angles not in ("", "rad", "deg"):
            self.explain("joint positions in: type rad or deg, or nothing.")
        elif lengths not in ("", "m", "mm"):
            self.explain("points in: type m or mm, or nothing.")
        else:
            path = Path(readings).expanduser()
            run = Path(self.typed("run") or self._home / RUNS / path.stem.lower().replace(" ", "-")).expanduser()
            angle, length = cast(Literal["rad", "deg", ""], angles), cast(Literal["m", "mm", ""], lengths)
            self.dismiss(OwnReadingsRequest(path, self.typed("arm"), angle, length, run))


def _is_table(path: Path) -> bool:
    return path.suffix.lower() in (".csv", ".txt", ".tsv", ".dat")
