"""A file of targets as plain data, with its names of places for messages: the same for YAML and CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from cellapp.cell.profile.loader import EXPONENT
from cellapp.cell.profile.messages import KeyPath, dotted, short, value_message
from cellapp.ground.counting import did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import file_text

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
        words += did_you_mean(str(at[-1]), known, otherwise=f"; known here are {', '.join(known)}")
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


# -- Read a YAML file of targets or paths as plain data, with the line of each value ----------------------------------


_MOST_LEVELS = 50
"""Largest nesting depth; a list of targets has about seven levels."""
_NESTED = "nested too deeply; a {} has a few levels"
_TOO_DEEP = "maximum nesting depth"
"""Message of PyYAML from 6.0.4, which limits the depth itself; earlier versions recurse until the process dies."""


class _TargetLoader(yaml.CSafeLoader):
    """YAML's safe loader that also reads 1e-3 as a number and refuses duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return the keys with their values."""
        written = [key for key, _ in node.value]  # before construction, which adds the keys of a merge key
        result = super().construct_mapping(node, deep)
        if len(result) < len(written):
            names = [key.value for key in written]
            for key in reversed(written):
                if names.count(key.value) > 1:
                    raise yaml.MarkedYAMLError(problem=f"key '{key.value}' is there twice", problem_mark=key.start_mark)
        return result


_TargetLoader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+.0123456789"))


def read_yaml(path: Path, what: str = "target list", forms: str = "YAML or CSV") -> TargetSource:
    """Read a file. Raise ``InputError`` with file and line if it is not YAML of plain values."""
    text = file_text(path, f"give a {what} ({forms})")
    try:
        _check_levels(path, text, what)
        loader = _TargetLoader(text)
        root = loader.get_single_node()
        content = None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = "" if mark is None else f":{mark.line + 1}"
        if _TOO_DEEP in (error.problem or ""):
            raise InputError(f"{path}{line}: {_NESTED.format(what)}") from None
        raise InputError(f"{path}{line}: not YAML: {error.problem or error.context}; correct the line") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not YAML: {getattr(error, 'reason', error)}; remove that character") from None
    except ValueError as error:  # a date such as 2026-99-99
        raise InputError(f"{path}: not YAML: {error}; put texts in quotes") from None
    return TargetSource(content, _places(path, root), dotted)


def _check_levels(path: Path, text: str, what: str) -> None:
    """Refuse too deep nesting: the loader recurses in C and would crash the program."""
    level = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            level += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            level -= 1
        if level > _MOST_LEVELS:
            line = "" if event.start_mark is None else f":{event.start_mark.line + 1}"
            raise InputError(f"{path}{line}: {_NESTED.format(what)}")


def _places(path: Path, root: yaml.Node | None) -> Callable[[KeyPath], str]:
    def place(location: KeyPath) -> str:
        """Return the line of the innermost existing part of a location: that of its key, if it has one."""
        node, line = root, 1
        for key in location:
            if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
                node = at = node.value[key]
            elif isinstance(node, yaml.MappingNode):
                below = [(name, value) for name, value in node.value if name.value == key]
                if not below:
                    break
                at, node = below[-1]
            else:
                break
            line = at.start_mark.line + 1
        return f"{path}:{line}"

    return place
