"""A file of targets as plain data, with its names of places for messages: the same for YAML and CSV."""

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
"""Number of problems in one message; the others are only counted."""
T = TypeVar("T")


@dataclass(frozen=True)
class TargetSource:
    """Contents of a file.

    Attributes
    ----------
    content : object
        Content as in YAML: keys with values; ``targets`` is a list with the keys of each target.
    place : callable
        Function that returns file and line, as "file:line", of the value at a path of keys.
    key : callable
        Function that returns the file's name of a value of a target, a dotted key or a column, from its path there.
    words : callable
        Function that adapts a message about a value to the file: advice about units differs.
    """

    content: object
    place: Callable[[KeyPath], str]
    key: Callable[[KeyPath], str]
    words: Callable[[str], str] = str


def placed_error(at: KeyPath, text: str) -> PydanticCustomError:
    """Return a validator's error about a value at the deeper keys ``at``, which ``location`` reads again."""
    return PydanticCustomError("placed", "{text}", {"text": text, "at": at})


def location(details: ErrorDetails) -> KeyPath:
    """Return the path of keys of an error, including that of ``placed_error``."""
    return (*details["loc"], *details.get("ctx", {}).get("at", ()))


def checked(adapter: TypeAdapter[T], value: object, at: KeyPath) -> T:
    """Validate a value as its type. Raise an error placed at the keys ``at`` and below."""
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        details = error.errors(include_url=False)[0]
        raise placed_error((*at, *location(details)), value_message(details)) from None


def refusal(source: TargetSource, problems: Sequence[tuple[KeyPath, str]]) -> InputError:
    """Return the error with the first problems, each given as a path of keys and a complete sentence."""
    lines = [f"{source.place(at)}: {source.words(text)}" for at, text in problems[:_MOST_SHOWN]]
    more = [f"and {len(problems) - _MOST_SHOWN} more"] if len(problems) > _MOST_SHOWN else []
    return InputError("\n".join(lines + more))


def sentences(
    source: TargetSource, error: ValidationError, known_keys: Callable[[KeyPath], Sequence[str]]
) -> list[tuple[KeyPath, str]]:
    """Return for each wrong value the path of keys and a sentence with its name and what is wrong.

    ``known_keys`` returns the keys that are allowed at the level of a path's last key.
    """
    listed = [(location(details), details) for details in error.errors(include_url=False)]
    return [
        (at, _sentence(source, at, details, known_keys))
        for at, details in listed
        # a list is not too short if its own items are wrong: those are reported
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
    """Return what people call the target or frame at a path of keys; empty for other parts."""
    match at:
        case ("targets", int(index), *_):
            keys = content["targets"][index] if isinstance(content, dict) else None
            name = keys.get("name") if isinstance(keys, dict) else None
            return f"target '{short(name)}'" if isinstance(name, str) and name else f"target {index + 1}"
        case ("frames", str(name), *_):
            return f"frame '{short(name)}'"
        case _:
            return ""
