"""A file of targets as plain data, and how that file names a place in it: the same for YAML and for CSV."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from cellapp.cell.profile.messages import KeyPath, dotted, short, value_message
from cellapp.ground.errors import InputError

_MOST_SHOWN = 5
"""Problems in one refusal; further ones are counted."""
T = TypeVar("T")


@dataclass(frozen=True)
class TargetSource:
    """What a file says.

    Attributes
    ----------
    content : object
        As YAML: keys with values; ``targets`` is a list with the keys of each target.
    place : callable
        File and line, as "file:line", of the value to which a path of keys leads.
    key : callable
        What the file calls a value of a target, from its path inside the target: a dotted key, or a column.
    words : callable
        A message about a value as it fits the file: advice about units differs.
    """

    content: object
    place: Callable[[KeyPath], str]
    key: Callable[[KeyPath], str]
    words: Callable[[str], str] = str


def placed_error(at: KeyPath, text: str) -> PydanticCustomError:
    """An error of a validator about a value that lies deeper, at the keys ``at``; ``location`` finds them again."""
    return PydanticCustomError("placed", "{text}", {"text": text, "at": at})


def location(details: ErrorDetails) -> KeyPath:
    """The path of keys of an error, with that of ``placed_error``."""
    return (*details["loc"], *details.get("ctx", {}).get("at", ()))


def checked(adapter: TypeAdapter[T], value: object, at: KeyPath) -> T:
    """A value as its type. Raises an error that is placed at the keys ``at`` and below."""
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        raise placed_error((*at, *location(details)), value_message(details)) from None


def refusal(source: TargetSource, problems: Sequence[tuple[KeyPath, str]]) -> InputError:
    """The first few problems, each the path of keys to where it lies, and the whole of its words."""
    lines = [f"{source.place(at)}: {source.words(text)}" for at, text in problems[:_MOST_SHOWN]]
    more = [f"and {len(problems) - _MOST_SHOWN} more"] if len(problems) > _MOST_SHOWN else []
    return InputError("\n".join(lines + more))


def sentences(
    source: TargetSource, error: ValidationError, known_keys: Callable[[KeyPath], Sequence[str]]
) -> list[tuple[KeyPath, str]]:
    """The path to each value that is wrong, and what it is called with what is wrong.

    ``known_keys`` are those that may stand beside the one to which a path leads.
    """
    listed = [(location(details), details) for details in error.errors(include_url=False)]
    return [
        (at, _sentence(source, at, details, known_keys))
        for at, details in listed
        # items that are wrong count as missing
        if details["type"] != "too_short" or not any(other[: len(at)] == at for other, _ in listed if other != at)
    ]


def _sentence(
    source: TargetSource, at: KeyPath, details: ErrorDetails, known_keys: Callable[[KeyPath], Sequence[str]]
) -> str:
    label, inside = _label(source.content, at), at[2:]
    key = dotted(at) or "the file"
    if label:
        key = source.key(inside) if at[0] == "targets" else dotted(inside)
    words = value_message(details)
    if details["type"] == "extra_forbidden":
        known = known_keys(at)
        near = difflib.get_close_matches(str(at[-1]), known, n=1)
        words += f"; did you mean '{near[0]}'?" if near else f"; known here are {', '.join(known)}"
    return ": ".join(filter(None, (label, key, words)))


def _label(content: object, at: KeyPath) -> str:
    """What a person calls the target or frame to which a path leads; empty for other parts."""
    match at:
        case ("targets", int(index), *_):
            keys = content["targets"][index] if isinstance(content, dict) else None
            name = keys.get("name") if isinstance(keys, dict) else None
            return f"target '{short(name)}'" if isinstance(name, str) and name else f"target {index + 1}"
        case ("frames", str(name), *_):
            return f"frame '{short(name)}'"
        case _:
            return ""
