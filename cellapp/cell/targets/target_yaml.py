"""Read a YAML file of targets or paths as plain data, with the line of each value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from cellapp.cell.profile.loader import EXPONENT
from cellapp.cell.profile.messages import KeyPath, dotted
from cellapp.cell.targets.target_source import TargetSource
from cellapp.ground.errors import InputError

_MOST_LEVELS = 50
"""Largest nesting depth; a list of targets has about seven levels."""
_NESTED = "nested too deeply; a {} has a few levels"
_TOO_DEEP = "maximum nesting depth"
"""Message of PyYAML from 6.0.4, which limits the depth itself; earlier versions recurse until the process dies."""


class _Loader(yaml.CSafeLoader):
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


_Loader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+.0123456789"))


def read_yaml(path: Path, what: str = "target list", forms: str = "YAML or CSV") -> TargetSource:
    """Read a file. Raise ``InputError`` with file and line if it is not YAML of plain values."""
    text = _text(path, what, forms)
    try:
        _check_levels(path, text, what)
        loader = _Loader(text)
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


def _text(path: Path, what: str, forms: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: cannot be read: file not found; give a {what} ({forms})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a {what} ({forms})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text; write the {what} as UTF-8 YAML") from None


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
