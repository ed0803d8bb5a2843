"""A dialog made from the record of a verb: a field for each labelled field of its request."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin

from textual.app import ComposeResult
from textual.containers import ItemGrid
from textual.widget import Widget
from textual.widgets import Input, Static

from cellapp.commands.record import Asked, Request, Verb
from cellapp.ground.errors import InputError
from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.question import AnswerQuestion, ChosenAnswer
from cellapp.interfaces.tui.widgets.controls import Box, Labelled, text_field

_COLUMN = 30
"""Width of a check box with its words, or of a number with its label."""
_MOST_IN_ONE_COLUMN = 4
"""Numbers in one column; more are arranged in columns, so that the dialog fits into the smallest terminal."""


class VerbQuestion(AnswerQuestion[Request]):
    """Ask for the request of a verb. Returns the request; None if the dialog is closed or answered with no.

    If no arm moves, the first empty field has the focus, and Enter in a field gives the first answer.

    Parameters
    ----------
    verb : Verb
    text : str
        What a person must know to answer.
    answers : sequence of ChosenAnswer
        "no" closes; any other begins. The first one has the focus.
    given : mapping
        Values of fields that are not asked for, as the folder of the run.
    proposed : mapping
        Initial values of fields, if not their default.
    choices : mapping
        Field -> texts that the right arrow completes; for a field with several values, the possible ones.
    simulated : bool
        Whether the cell is simulated; otherwise fields for simulated cells are omitted.
    """

    def __init__(
        self,
        verb: Verb,
        text: str,
        answers: Sequence[ChosenAnswer],
        given: Mapping[str, Any],
        *,
        proposed: Mapping[str, Any] | None = None,
        choices: Mapping[str, Sequence[str]] | None = None,
        simulated: bool = False,
    ) -> None:
        super().__init__(verb.question, text, answers)
        self.verb, self._given = verb, dict(given)
        self._proposed, self._choices = dict(proposed or {}), dict(choices or {})
        self._fields = {
            name: words
            for name, words in verb.request.asked()
            if words.label and name not in given and (simulated or not words.simulated)
        }

    def fields(self) -> ComposeResult:
        """Yield a widget for each field; its id is the field's name with hyphens."""
        for short, names in groupby(self._fields, self._is_number):
            widgets = [widget for name in names for widget in self._widgets(name, self._fields[name])]
            if short and len(widgets) > _MOST_IN_ONE_COLUMN:
                yield ItemGrid(*widgets, min_column_width=_COLUMN)
            else:
                yield from widgets

    def on_mount(self) -> None:
        """Focus the first empty field, if nothing can move by it."""
        super().on_mount()
        empty = [field for field in self.query(Input) if not field.value]
        if empty and not self.verb.moves_arms:
            self.call_after_refresh(empty[0].focus)

    def entered(self) -> None:
        """Give the first answer; if arms may move, go to the answers."""
        if self.verb.moves_arms:
            super().entered()
        else:
            self.action_answer(self._answers[0].value)

    def action_answer(self, value: str) -> None:
        """Close with the request; if the fields are not valid, say why."""
        if value == "no":
            self.dismiss(None)
            return
        values = {name: self._value(name) for name in self._fields}
        given = {name: value for name, value in values.items() if value is not None}
        try:
            self.dismiss(self.verb.asked({**self._given, **given}, named=self._called))
        except InputError as error:
            self.explain(str(error))

    def _called(self, field: str) -> str:
        return self._fields[field].label if field in self._fields else field

    def _widgets(self, name: str, words: Asked) -> Iterator[Widget]:
        kind, default = self._kind(name), self._proposed.get(name, self._default(name))
        label, key = f"{words.label} [{words.unit}]" if words.unit else words.label, _id(name)
        if kind is bool:
            yield Box(label, bool(default), id=key, compact=True)
        elif get_origin(kind) is tuple and self._possible(name):
            yield Static(f"{label}:", markup=False)
            boxes = (
                Box(words.words.get(one, one), one in (default or ()), id=f"{key}-{one}", compact=True)
                for one in self._possible(name)
            )
            yield ItemGrid(*boxes, min_column_width=_COLUMN)
        elif kind is Path or words.suffixes:
            text = "" if default is None else str(default)
            yield Labelled(label, PathField(text, words.suffixes, id=key, hint=words.hint))
        else:
            several = get_origin(kind) is tuple
            shown = default if isinstance(default, tuple) else () if default is None else (default,)
            text = ", ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in shown)
            choices = [] if several else [str(one) for one in self._choices.get(name, get_args(kind))]
            yield text_field(label, key, text, words.hint or " or ".join(choices), choices=choices)

    def _value(self, name: str) -> Any:
        """Return the value of a field; None if it is empty and may be."""
        kind = self._kind(name)
        if kind is bool:
            return self.query_one(f"#{_id(name)}", Box).value
        if get_origin(kind) is tuple and self._possible(name):
            boxes = {one: self.query_one(f"#{_id(name)}-{one}", Box) for one in self._possible(name)}
            return tuple(one for one, box in boxes.items() if box.value)
        text = self.query_one(f"#{_id(name)}", Input).value.strip()
        if get_origin(kind) is tuple:
            return tuple(one.strip() for one in text.split(",") if one.strip())
        if not text:
            return None if self._default(name) is None else ""
        if kind in (int, float):
            with suppress(ValueError):  # the request says what is wrong with it
                return kind(text)
        return Path(text).expanduser() if kind is Path else text

    def _is_number(self, name: str) -> bool:
        """Return whether a field takes a number, or several."""
        kind = self._kind(name)
        return kind in (int, float) or (get_origin(kind) is tuple and get_args(kind)[0] in (int, float))

    def _possible(self, name: str) -> Sequence[str]:
        """Return the possible values of a field that takes several of them."""
        return self._choices.get(name) or get_args(get_args(self._kind(name))[0])

    def _kind(self, name: str) -> Any:
        """Return the type of a field's value, without None."""
        annotation = self.verb.request.model_fields[name].annotation
        if get_origin(annotation) in (Union, UnionType):
            return next(one for one in get_args(annotation) if one is not type(None))
        return annotation

    def _default(self, name: str) -> Any:
        field = self.verb.request.model_fields[name]
        return None if field.is_required() else field.default


def _id(name: str) -> str:
    return name.replace("_", "-")
