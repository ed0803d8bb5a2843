"""Ask before a few stops are measured to see whether the calibration still holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from textual.app import ComposeResult

from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.question import Answer, AnswerQuestion
from cellapp.interfaces.tui.widgets.labelled import Labelled, text_field

STOPS, FEWEST_STOPS = 20, 4
"""As ``cellapp.commands.check.run`` has them, which loads more than a dialog needs."""
_YAML = (".yaml", ".yml")


@dataclass(frozen=True)
class CheckRequest:
    """What ``check`` is asked for; see ``check_run``. ``plant`` is a profile whose hidden physics are simulated."""

    stops: int
    plant: Path | None = None


class CheckCalibration(AnswerQuestion[CheckRequest]):
    """Returns the request; None where the dialog is closed or answered with no.

    Parameters
    ----------
    text : str
        What a person must know to answer.
    answers : sequence of Answer
        "no" closes; any other begins. The first one has the focus.
    simulated : bool
        Whether the cell is simulated: it can show a change.
    """

    def __init__(self, text: str, answers: Sequence[Answer], *, simulated: bool) -> None:
        super().__init__("Check the calibration?", text, answers)
        self._simulated = simulated

    def fields(self) -> ComposeResult:
        """How many stops there may be, and which cell is simulated."""
        yield text_field("stops at most", "stops", str(STOPS), "of all arms together")
        if self._simulated:
            yield Labelled("simulate plant of", PathField("", lambda path: path.suffix in _YAML))

    def action_answer(self, value: str) -> None:
        """Close with the request; with a number that does not fit, say so."""
        stops = self.typed("stops")
        plant = self.query_one(PathField).value.strip() if self._simulated else ""
        if value == "no":
            self.dismiss(None)
        elif stops.isascii() and stops.isdigit() and int(stops[:6]) >= FEWEST_STOPS:
            self.dismiss(CheckRequest(int(stops[:6]), Path(plant).expanduser() if plant else None))
        else:
            self.explain(f"Type how many stops, at least {FEWEST_STOPS}.")
