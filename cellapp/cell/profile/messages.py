"""Validation errors of a profile in words: file, line, key, what was expected, what was written."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from cellapp.ground.counting import did_you_mean, first_few
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import Profile
from cellapp.ground.removed import removed_key
from drivers.settings import OneOf, Section

Key = str | int
KeyPath = tuple[Key, ...]

_LONGEST = 600
"""Largest number of characters of one error; that of an unusable plug-in needs 500."""
_MISSING = ": missing; it must be given"
_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "keys with values",
    "model_type": "keys with values",
    "model_attributes_type": "keys with values",
}
"""What was expected, by pydantic's type of error."""
_BOUNDS = {
    "greater_than": ("gt", "more than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}
"""pydantic's error of a range -> key of its bound in the error's context, and words for it."""


_MEANT = {"offset": "theta", "r": "a", "length": "a", "twist": "alpha", "limits": "limit", "velocity": "speed"}
"""Keys of other programs -> cellapp's."""


@dataclass(frozen=True)
class Spot:
    """Where a value is written: file, line (0: not in a file), and its path inside that file."""

    file: str
    line: int
    inside: KeyPath

    def __str__(self) -> str:
        """Return "file:line: key"; without a key at the top of a file."""
        key, file = dotted(self.inside), f"{self.file}:{self.line}" if self.line else self.file
        return f"{file}: {key}" if key else file


class PlacedError(InputError):
    """Bad input at one place of a profile."""

    def __init__(self, place: Spot, words: str) -> None:
        super().__init__(f"{place}: {words}")


@dataclass
class YamlDocument:
    """A profile, or another file of ``schema``, as plain data, with the place of each of its values."""

    data: Any = None
    places: dict[KeyPath, Spot] = field(default_factory=dict)
    schema: type[Section] = Profile


def dotted(path: Sequence[Key]) -> str:
    """Return a path in the usual notation: "arms.left.home[2]"."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{short(key)}" for key in path)
    return text.removeprefix(".")


def short(text: str, most: int = 60) -> str:
    """Return a text of a profile on one line, cut to ``most`` characters."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[: most - 3] + "..."


def described(value: object) -> str:
    """Describe a value in a person's words."""
    match value:
        case yaml.SequenceNode():
            return "a list"
        case yaml.ScalarNode():
            return f"'{short(value.value)}'"
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case str():
            return f"'{short(value)}'"
        case dict():
            return "keys with values"
        case list() | tuple():
            return f"a list of {len(value)}"
        case _:
            return str(value)


def validation_message(error: ValidationError, document: YamlDocument) -> str:
    """Return one line for each error, in the order of the file; after the first few, their number."""
    located = [(document.places[at], texts) for at, texts in _found(error, document)]
    ordered = sorted(located, key=lambda entry: (entry[0].file, entry[0].line))
    return "\n".join(first_few([_sentence(place, texts) for place, texts in ordered], "and {} more"))


def value_message(details: ErrorDetails) -> str:
    """Return one error in words, without its place; for files other than profiles."""
    match details["type"]:
        case "missing":
            return _MISSING.removeprefix(": ")
        case "extra_forbidden":
            return "unknown key"
        case "value_error":
            return plain(details["msg"])
        case _:
            return _expected(details, (), YamlDocument(details["input"]))


def plain(message: str) -> str:
    """Return a message of pydantic without its technical words."""
    return message.removeprefix("Value error, ").replace("got NoneType", "got nothing")


def _found(error: ValidationError, document: YamlDocument) -> list[tuple[KeyPath, list[str]]]:
    """Return the written path of each error with its messages: several for the alternatives of one value."""
    found: dict[tuple[KeyPath, str], list[str]] = {}
    for details in _without_literal_branches(error.errors(include_url=False), document.places):
        at, message = _located_message(details, document)
        missing = message.partition(": ")[0] if message.endswith(_MISSING) else ""
        texts = found.setdefault((at, missing), [])
        if message not in texts:
            texts.append(message)
    return [(at, texts) for (at, _), texts in found.items()]


def _without_literal_branches(errors: Sequence[ErrorDetails], places: dict[KeyPath, Spot]) -> Iterator[ErrorDetails]:
    """Drop "expected the word 'unknown', got a list" if another error concerns the same list, "at least 2 values" of a
    list that has them, and an unknown key that an earlier row of the same list has."""
    paths = [_walk(details["loc"], places)[0] for details in errors]
    seen = set[tuple[Key, ...]]()
    for index, (at, details) in enumerate(zip(paths, errors, strict=True)):
        rows = tuple(0 if isinstance(key, int) else key for key in details["loc"])
        if details["type"] == "extra_forbidden" and rows in seen:
            continue
        seen.add(rows)
        if details["type"] == "too_short" and len(details["input"]) >= details.get("ctx", {})["min_length"]:
            continue
        others = paths[:index] + paths[index + 1 :]
        word = details["type"] == "literal_error" and isinstance(details["input"], list | tuple | dict)
        if not (word and any(other[: len(at)] == at for other in others)):
            yield details


def _sentence(place: Spot, texts: Sequence[str]) -> str:
    words = _joined(texts)
    return f"{place}{words}" if words.startswith(".") else f"{place}: {words}"


def _joined(texts: Sequence[str]) -> str:
    """Return the messages of one value as one: alternatives "expected A, got x" and "expected B, got x"."""
    first, rest = texts[0], texts[1:]
    if rest:
        expected = [text.removeprefix("expected ").partition(", got ")[0] for text in texts]
        first = f"expected {' or '.join(expected)}, got {texts[0].partition(', got ')[2]}"
    return short(first, _LONGEST)


def _located_message(details: ErrorDetails, document: YamlDocument) -> tuple[KeyPath, str]:
    """Return the written path of an error and its message; a message that starts with a dot continues the key."""
    at, rest = _walk(details["loc"], document.places)
    kind = details["type"]
    if kind == "extra_forbidden":
        return at, _unknown_key(details["loc"], at, document.schema)
    if kind == "missing":
        return at, _missing(details["loc"], at, rest, document)
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        return _wrong_kind(details, at, document)
    if kind == "value_error":
        return _own_message(at, plain(details["msg"]), document.places)
    return at, _expected(details, at, document)


def _missing(location: Sequence[Key], at: KeyPath, rest: Sequence[Key], document: YamlDocument) -> str:
    if not rest:  # an empty cell of a table
        return _MISSING.removeprefix(": ")
    last = rest[-1]
    if isinstance(last, int):
        expected = _tuple_length(location, last + 1, document.schema)
        return f"expected {expected} values, got {described(_value(document.data, at))}"
    dot = "." if document.places[at].inside else ""
    return f"{dot}{last}{_MISSING}"


def _wrong_kind(details: ErrorDetails, at: KeyPath, document: YamlDocument) -> tuple[KeyPath, str]:
    """Describe a device's key ``kind`` that is missing or names no kind."""
    context = details.get("ctx", {})
    key = str(context["discriminator"]).strip("'")
    if details["type"] == "union_tag_not_found":
        return at, f".{key}{_MISSING}"
    message = f"expected {_choices(str(context['expected_tags']))}, got '{context['tag']}'"
    return ((*at, key) if (*at, key) in document.places else at), message


def _expected(details: ErrorDetails, at: KeyPath, document: YamlDocument) -> str:
    """Describe a value that has the wrong type, size or length."""
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    got = described(value)
    if kind in _EXPECTED:
        hint = "; put it in quotes" if kind == "string_type" and isinstance(value, int | float) else ""
        return f"expected {_EXPECTED[kind]}, got {got}{hint}"
    if kind in _BOUNDS:
        key, words = _BOUNDS[kind]
        unit = " (SI)" if isinstance(value, str) else ""  # the bound is in SI, the value in another unit
        return f"expected {words} {context[key]:g}{unit}, got {got}"
    match kind:
        case "literal_error":
            hint = did_you_mean(str(value), re.findall(r"'([^']*)'", str(context["expected"])))
            return f"expected {_choices(str(context['expected']))}, got {got}{hint}"
        case "too_long":
            return f"expected at most {context['max_length']} values, got {described(_value(document.data, at))}"
        case "too_short":
            return f"expected at least {context['min_length']} values, got {got}"
        case "string_too_short":
            return "expected a text, got an empty one"
        case "string_pattern_mismatch":
            return f"expected a text of the form {context['pattern'].strip('^$')}, got {got}"
        case _:
            return plain(details["msg"])


def _walk(location: Sequence[Key], places: dict[KeyPath, Spot]) -> tuple[KeyPath, list[Key]]:
    """Return the longest part of pydantic's location that is written in the file, and the keys that remain.

    The location also contains the names of a union's branches, which are not written in the file.
    """
    at: KeyPath = ()
    rest: list[Key] = []
    for key in location:
        if (*at, key) in places:
            at, rest = (*at, key), []
        else:
            rest.append(key)
    return at, rest


def _value(data: Any, at: KeyPath) -> Any:
    for key in at:
        data = data[key]
    return data


def _own_message(at: KeyPath, message: str, places: dict[KeyPath, Spot]) -> tuple[KeyPath, str]:
    """Move the key with which the schema's own messages start into the path."""
    match = re.match(r"([A-Za-z_][\w.\[\]]*): ", message)
    if not match:
        return at, message
    keys = tuple(int(key) if key.isdigit() else key for key in re.findall(r"\w+", match.group(1)))
    known = next(count for count in range(len(keys), -1, -1) if (*at, *keys[:count]) in places)
    here = (*at, *keys[:known])
    dot = "." if keys[known:] and isinstance(keys[known], str) and places[here].inside else ""
    rest = f"{dot}{dotted(keys[known:])}: " if keys[known:] else ""
    return here, rest + message[match.end() :]


def _choices(expected: str) -> str:
    words = re.findall(r"'[^']*'", expected)
    return expected if len(words) < 2 else f"{', '.join(words[:-1])} or {words[-1]}"


# -- what the schema allows at a location -----------------------------------------------------------------------------


def _tuple_length(location: Sequence[Key], least: int, schema: type[Section]) -> int:
    """Return the length of the tuple whose item at the end of ``location`` is missing."""
    fixed = [get_args(hint) for hint in _types_at(location[:-1], schema) if get_origin(hint) is tuple]
    return max((len(items) for items in fixed if ... not in items), default=least)


def _unknown_key(location: Sequence[Key], at: KeyPath, schema: type[Section]) -> str:
    if removed := removed_key(at):
        return removed
    known = [name for hint in _types_at(location[:-1], schema) for name in _fields_of(hint)]
    key = str(location[-1])
    hint = did_you_mean(_MEANT.get(key, key), known, cutoff=0.5, otherwise=f"; known here are {', '.join(known)}")
    return f"unknown key{hint}"


def _types_at(location: Sequence[Key], schema: type[Section]) -> list[Any]:
    """Return the types that the schema allows at a location."""
    hints: list[Any] = [schema]
    for key in location:
        below: list[Any] = []
        for hint in hints:
            fields = _fields_of(hint)
            if isinstance(key, str) and key in fields:
                below += _alternatives(fields[key])
            elif get_origin(hint) is dict:
                below += _alternatives(get_args(hint)[1])
            elif get_origin(hint) is tuple and isinstance(key, int):
                below += _alternatives(get_args(hint)[0])
            elif any(key in get_args(fields[name]) for name in ("kind", "shape") if name in fields):
                below.append(hint)  # the branch of a union that was selected by its kind or shape
        hints = below or hints
    return hints


def _fields_of(hint: Any) -> dict[str, Any]:
    if isinstance(hint, type) and issubclass(hint, Section):
        return {info.alias or name: info.rebuild_annotation() for name, info in hint.model_fields.items()}
    return {}


def _alternatives(hint: Any) -> Iterator[Any]:
    """Yield the types of a union, without None and annotations."""
    if get_origin(hint) is Annotated:
        annotated, *metadata = get_args(hint)
        kinds = [kind for item in metadata if isinstance(item, OneOf) for kind in item.kinds]
        yield from kinds or _alternatives(annotated)
    elif get_origin(hint) in (Union, UnionType):
        for part in get_args(hint):
            yield from _alternatives(part)
    elif hint is not NoneType:
        yield hint
