"""Ask before a tracker that was moved is located: how many points, and roughly where it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Button, Input, Static

from cellapp.errors import InputError
from cellapp.profile import Pose
from cellapp.tui.dialogs.question import Answer, Question

FEWEST, USUAL = 3, 4


@dataclass(frozen=True)
class LocateRequest:
    """What ``locate_run`` takes."""

    points: int
    tracker_pose: Pose | None
    simulated_pose: Pose | None


class LocateTracker(Question[LocateRequest]):
    """Returns the request; None where the dialog is closed or answered with no.

    Parameters
    ----------
    text : str
        What a person must know to answer.
    answers : sequence of Answer
        "no" closes; any other begins. The first one has the focus.
    simulated : bool
        Whether the tracker is simulated, so that it can be put elsewhere.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,up", "app.focus_previous", show=False),
        Binding("right,down", "app.focus_next", show=False),
    ]
    DEFAULT_CSS = """
    LocateTracker #points { width: 12; }
    """

    def __init__(self, text: str, answers: Sequence[Answer], *, simulated: bool) -> None:
        super().__init__()
        self._text, self._answers, self._simulated = text, tuple(answers), simulated

    def body(self) -> ComposeResult:
        yield Static("Locate the tracker?", classes="title", markup=False)
        yield Static(self._text, classes="text", markup=False)
        yield Static(f"Points of all arms together, at least {FEWEST}:", markup=False)
        yield Input(str(USUAL), id="points", compact=True, restrict="[0-9]{0,2}", select_on_focus=True)
        yield Static("Where it stands now: x,y,z in m, roll,pitch,yaw in deg. Empty: about where it was:", markup=False)
        yield Input("", id="pose", compact=True, restrict=r"[-+0-9., ]*")
        if self._simulated:
            yield Static("Simulated cell: put the tracker there first, in the same form:", markup=False)
            yield Input("", id="simulated", compact=True, restrict=r"[-+0-9., ]*")
        yield Static("", id="why", classes="text", markup=False)
        with Horizontal(classes="answers"):
            for answer in self._answers:
                label = f"{answer.label} ({answer.key})"
                yield Button(label, id=answer.value, variant=answer.variant, compact=True)

    def on_mount(self) -> None:
        """Let each answer be given by its key, over the fields too: they take no letters."""
        for answer in self._answers:
            self._bindings.bind(answer.key, f"answer('{answer.value}')", answer.label)
        self.query(Button).first().focus()

    def action_answer(self, value: str) -> None:
        """Close with an answer; say what is wrong with a field."""
        if value == "no":
            self.dismiss(None)
            return
        try:
            self.dismiss(self._request())
        except InputError as error:
            self.query_one("#why", Static).update(str(error))

    def _request(self) -> LocateRequest:
        points = int(self.query_one("#points", Input).value or str(USUAL))
        if points < FEWEST:
            raise InputError(f"Type a number of points from {FEWEST}.")
        simulated = self._pose("#simulated", "put there") if self._simulated else None
        return LocateRequest(points, self._pose("#pose", "stands now"), simulated)

    def _pose(self, field: str, what: str) -> Pose | None:
        from cellapp.locate_verb import typed_pose

        text = self.query_one(field, Input).value.strip()
        return typed_pose(text, what) if text else None

    @on(Button.Pressed)
    def press(self, event: Button.Pressed) -> None:
        """Close with the answer of the button."""
        event.stop()
        self.action_answer(event.button.id or "")

    @on(Input.Submitted)
    def leave_field(self, event: Input.Submitted) -> None:
        """Enter in a field goes to the answers: nothing moves by it."""
        event.stop()
        self.query(Button).first().focus()
