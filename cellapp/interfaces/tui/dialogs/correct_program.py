"""Ask which program of a controller is corrected, for which arm, and where the copy is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.widgets import Button, Checkbox, Input, Static

from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.write_question import WriteQuestion
from cellapp.interfaces.tui.widgets.labelled import Labelled, text_field


@dataclass(frozen=True)
class CorrectRequest:
    """What ``correct`` is asked for; see ``correct_run``. ``tcp`` is what a person typed; None for nothing."""

    program: Path
    out: Path
    arm: str | None
    tcp: str | None
    partly: bool
    extrapolate: bool


class CorrectProgram(WriteQuestion[CorrectRequest]):
    """Ask how a program is corrected. Returns the request; None where the dialog is closed.

    Parameters
    ----------
    program : Path
    arms : sequence of str
    """

    def __init__(self, program: Path, arms: Sequence[str]) -> None:
        super().__init__()
        self._program, self._arms = program, tuple(arms)

    def body(self) -> ComposeResult:
        yield Static(f"Correct {self._program.name}", classes="title", markup=False)
        proposed = self._program.with_stem(f"{self._program.stem}-corrected")
        yield Labelled("corrected copy", PathField(str(proposed), lambda path: path.suffix == self._program.suffix))
        only = self._arms[0] if len(self._arms) == 1 else ""
        yield text_field("arm", "arm", only, " or ".join(self._arms), choices=self._arms)
        yield text_field("TCP (m, rad)", "tcp", hint="x,y,z,rx,ry,rz; empty: the program's set_tcp")
        yield Checkbox("write although some targets cannot be corrected", id="partly", compact=True)
        yield Checkbox("correct outside the joint ranges of the readings too", id="extrapolate", compact=True)
        yield Static(f"Enter writes, {self.closing_key} closes. Nothing moves.", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Write (Ctrl+S)", id="write", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Begin with the arm, or with the file where there is but one."""
        self.query_one("#arm" if len(self._arms) > 1 else "#path", Input).focus()

    def action_send(self) -> None:
        """Close with the request; the verb judges it."""
        path, arm, tcp = (self.typed(name) for name in ("path", "arm", "tcp"))
        partly, extrapolate = (self.query_one(f"#{name}", Checkbox).value for name in ("partly", "extrapolate"))
        if not path:
            self.query_one("#path").focus()
            return
        out = Path(path).expanduser()
        self.dismiss(CorrectRequest(self._program, out, arm or None, tcp or None, partly, extrapolate))
