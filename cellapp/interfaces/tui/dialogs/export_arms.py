"""Ask in which format, and where, the calibrated arms or the commands are written for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Input, OptionList, Static
from textual.widgets.option_list import Option

from cellapp.cell.exports.formats import all_formats
from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.write_question import WriteQuestion
from cellapp.interfaces.tui.widgets.labelled import Labelled, text_field

_STAGES = ("calibrate", "discover", "compensate", "verify")


@dataclass(frozen=True)
class ExportRequest:
    """What ``export`` is asked for; see ``export_as_run``."""

    format_name: str
    out: Path
    arm: str | None
    stage_name: str | None


class ExportArms(WriteQuestion[ExportRequest]):
    """Choose format, file, arm and stage. Returns the request; None where the dialog is closed.

    Parameters
    ----------
    folder : Path
        Folder of the run, where files are proposed.
    arms : sequence of str
    """

    DEFAULT_CSS = """
    ExportArms #formats { height: auto; }
    """

    def __init__(self, folder: Path, arms: Sequence[str]) -> None:
        super().__init__()
        self._folder, self._arms = folder, tuple(arms)
        self._proposed = ""

    def body(self) -> ComposeResult:
        yield Static("Calibrated arms and commands for other programs", classes="title", markup=False)
        options = [Option(f"{entry.name:15} {entry.what}", id=entry.name) for entry in all_formats().values()]
        yield OptionList(*options, id="formats", markup=False, compact=True)
        yield Labelled("file", PathField("", lambda path: True))
        yield text_field("arm (empty: all)", "arm", choices=self._arms)
        yield text_field("of stage", "stage", hint="empty: in force, or last", choices=_STAGES)
        yield Static(
            f"Enter goes on and writes, {self.closing_key} closes. Several arms get a file each.",
            classes="text",
            markup=False,
        )
        with Horizontal(classes="answers"):
            yield Button("Write (Ctrl+S)", id="write", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Begin with the formats."""
        formats = self.query_one("#formats", OptionList)
        formats.highlighted = 0
        formats.focus()

    @on(OptionList.OptionHighlighted)
    def propose(self, event: OptionList.OptionHighlighted) -> None:
        """Propose a file for the format, unless a person typed one."""
        event.stop()
        field = self.query_one("#path", Input)
        if field.value == self._proposed:
            entry = all_formats()[str(event.option.id)]
            self._proposed = str(self._folder / f"{entry.name}{entry.suffix}")
            field.value = self._proposed

    @on(OptionList.OptionSelected)
    def go_on(self, event: OptionList.OptionSelected) -> None:
        """Go to the file."""
        event.stop()
        field = self.query_one("#path", Input)
        field.focus()
        field.cursor_position = len(field.value)

    def action_send(self) -> None:
        """Close with the request; the verb judges it."""
        chosen = self.query_one("#formats", OptionList).highlighted_option
        path = self.typed("path")
        if chosen is None or not path:
            self.query_one("#path").focus()
            return
        arm, stage = (self.typed(name) or None for name in ("arm", "stage"))
        self.dismiss(ExportRequest(str(chosen.id), Path(path).expanduser(), arm, stage))
