"""The form of one target, checked while typing by the rules of a target list."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.events import DescendantFocus
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input, Label, Static

from cellapp.cell.targets.target_text import FIELDS, FormField, TypedTarget, frame_choices, typed_target
from cellapp.cell.targets.targets import Target
from cellapp.ground.profile import Profile
from cellapp.interfaces.tui.dialogs.question import FieldsQuestion


class FieldRow(Horizontal):
    """One field.

    Parameters
    ----------
    field_id : str
        The field's name.
    form : FormField
    text : str
        Initial text.
    choices : sequence of str
        Texts that the right arrow completes.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "app.focus_previous", show=False),
        Binding("down,enter", "app.focus_next", show=False),
    ]

    def __init__(self, field_id: str, form: FormField, text: str, choices: Sequence[str] = ()) -> None:
        super().__init__()
        self.field_id, self.form = field_id, form
        suggester = SuggestFromList(choices) if choices else None
        self.input = Input(text, placeholder=", ".join(choices), suggester=suggester, compact=True)
        self._problem = Static("", classes="problem", markup=False)

    def compose(self) -> ComposeResult:
        yield Label(self.form.label, markup=False)
        yield self.input
        yield self._problem

    def show_problem(self, words: str) -> None:
        """Show what is wrong; empty if nothing is."""
        self.set_class(bool(words), "wrong")
        self._problem.update(f"◂ {words}" if words else "")


class TargetForm(FieldsQuestion[Target]):
    """Edit a target, or type a new one. Returns it; None if the dialog is closed.

    Parameters
    ----------
    title : str
    before : Target or None
        The original target: an unchanged field keeps its value to the last bit.
    texts : mapping
        Initial texts of the fields, by name.
    others : sequence of Target
        The rest of the list: names must be unique.
    profile : Profile
        Its arms can be chosen.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+s", "send", "Take", priority=True)]

    def __init__(
        self, title: str, before: Target | None, texts: Mapping[str, str], others: Sequence[Target], profile: Profile
    ) -> None:
        super().__init__()
        self._title, self._before, self._texts = title, before, texts
        self._others, self._profile = others, profile

    def body(self) -> ComposeResult:
        yield Static(self._title, classes="title", markup=False)
        listed = self._others if self._before is None else [self._before, *self._others]
        choices = {"arm": tuple(self._profile.arms), "frame": frame_choices(listed, self._profile)}
        with VerticalScroll(classes="fields", can_focus=False):
            for field in FIELDS:
                row = FieldRow(field.name, field, self._texts[field.name], choices.get(field.name, ()))
                row.input.tooltip = field.help
                yield row
        yield Static("", id="target-help", classes="text", markup=False)
        with Horizontal(classes="answers"):
            yield Button("Take (Enter)", id="take", variant="success", compact=True)
            yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        """Focus the first field."""
        self._judge()
        self.query(Input).first().focus()

    def _judge(self) -> TypedTarget:
        """Check the fields and draw what is wrong beside them."""
        rows = list(self.query(FieldRow))
        texts = {row.field_id: row.input.value for row in rows}
        found = typed_target(texts, self._before, self._others, self._profile)
        for row in rows:
            row.show_problem(found.problems.get(row.field_id, ""))
        focused = self.focused.parent if self.focused is not None else None
        if isinstance(focused, FieldRow):
            wrong = found.problems.get(focused.field_id, "")
            self.query_one("#target-help", Static).update(
                f"{focused.form.label}: {wrong or focused.form.help}. {self.closing_key} closes."
            )
        return found

    @on(Input.Changed)
    def judge_text(self, event: Input.Changed) -> None:
        """Check the typed text."""
        event.stop()
        self._judge()

    def on_descendant_focus(self, event: DescendantFocus) -> None:
        """Explain the field."""
        self._judge()

    def action_send(self) -> None:
        """Close with the target; if something is wrong, focus that field."""
        found = self._judge()
        if found.target is not None:
            self.dismiss(found.target)
            return
        wrong = next(row for row in self.query(FieldRow) if row.field_id in found.problems)
        wrong.input.focus()
