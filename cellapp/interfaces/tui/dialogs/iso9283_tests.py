"""Ask which tests of ISO 9283 are made, with which commands, how often, how fast."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from textual.app import ComposeResult
from textual.containers import ItemGrid
from textual.widgets import Checkbox, Input, Static

from cellapp.interfaces.tui.dialogs.question import Answer, AnswerQuestion
from cellapp.interfaces.tui.widgets.labelled import text_field

if TYPE_CHECKING:
    from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest

CYCLES, DRIFT_MIN = 30, 60.0
"""As ``cellapp.commands.iso9283.run`` has them, which loads more than a dialog needs."""
_TESTS: Mapping[IsoTest, str] = {
    "pose": "pose: AP, RP",
    "multidirectional": "directions: vAP",
    "distance": "distance: AD, RD",
    "drift": "drift: dAP, dRP",
    "path": "path: AT, RT",
    "cooperative": "both arms together",
}
_COMMANDS: Mapping[IsoCommands, str] = {"nominal": "nominal, as found", "calibrated": "calibrated, as left"}
_WHOLE = 100.0
_COLUMN = 30
"""Width of a check box with its words."""


@dataclass(frozen=True)
class IsoRequest:
    """What ``iso9283`` is asked for; see ``iso9283_run``. ``speed_share`` is of the speed that the profile allows."""

    tests: tuple[IsoTest, ...]
    commands: tuple[IsoCommands, ...]
    cycles: int
    speed_share: float
    drift_minutes: float
    arms: tuple[str, ...] = ()


class Iso9283Tests(AnswerQuestion[IsoRequest]):
    """Returns the request; None where the dialog is closed or answered with no.

    Parameters
    ----------
    text : str
        What a person must know to answer.
    answers : sequence of Answer
        "no" closes; any other begins. The first one has the focus.
    arms : sequence of str
        Those of the cell; with one there is no cooperative test.
    commands : sequence of IsoCommands
        Those that are possible; without a calibration only the nominal ones.
    """

    DEFAULT_CSS = """
    Iso9283Tests ItemGrid { height: auto; grid-rows: 1; }
    """

    def __init__(
        self, text: str, answers: Sequence[Answer], arms: Sequence[str], commands: Sequence[IsoCommands]
    ) -> None:
        super().__init__("Measure by ISO 9283?", text, answers)
        self._arms, self._commands = tuple(arms), tuple(commands)
        self._tests = tuple(test for test in _TESTS if test != "cooperative" or len(arms) > 1)

    def fields(self) -> ComposeResult:
        """Tests, commands, cycles, speed, duration of the drift test, arm."""
        yield ItemGrid(
            *(Checkbox(_TESTS[name], name == "pose", id=name, compact=True) for name in self._tests),
            min_column_width=_COLUMN,
        )
        yield Static("commanded by the model:", markup=False)
        yield ItemGrid(
            *(Checkbox(_COMMANDS[name], True, id=name, compact=True) for name in self._commands),
            min_column_width=_COLUMN,
        )
        yield text_field("cycles", "cycles", str(CYCLES), f"{CYCLES} by the norm")
        yield text_field("speed [%]", "speed", "100", "of the speed that the profile allows")
        yield text_field("drift for [min]", "minutes", f"{DRIFT_MIN:g}", "480 by the norm")
        yield text_field("only arm", "arm", hint="empty: all of them", choices=self._arms)

    def action_answer(self, value: str) -> None:
        """Close with the request; where the fields make none, say why."""
        if value == "no":
            self.dismiss(None)
            return
        tests = tuple(name for name in self._tests if self._marked(name))
        commands = tuple(name for name in self._commands if self._marked(name))
        cycles, speed, minutes = (self._number(name) for name in ("cycles", "speed", "minutes"))
        arm = self.typed("arm")
        if not tests:
            self.explain("Mark a test: space marks it.")
        elif not commands:
            self.explain("Mark what is commanded: space marks it.")
        elif cycles is None or not cycles.is_integer():
            self.explain(f"Type how many cycles, as {CYCLES}.")
        elif speed is None or speed > _WHOLE:
            self.explain("Type the speed in percent, above 0, at most 100.")
        elif minutes is None:
            self.explain(f"Type for how many minutes drift is observed, as {DRIFT_MIN:g}.")
        else:
            self.dismiss(IsoRequest(tests, commands, int(cycles), speed / _WHOLE, minutes, (arm,) if arm else ()))

    def _marked(self, name: str) -> bool:
        return self.query_one(f"#{name}", Checkbox).value

    def _number(self, name: str) -> float | None:
        """The number above 0 in a field; None where it holds none."""
        try:
            number = float(self.query_one(f"#{name}", Input).value)
        except ValueError:
            return None
        return number if 0.0 < number < math.inf else None
