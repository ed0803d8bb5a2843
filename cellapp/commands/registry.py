"""The verbs in the order of the work. A new verb is a file or a folder here, and a word below.

None is imported before somebody asks for its record: a small verb brings all that it needs to run.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellapp.commands.record import Verb

STORING = ("calibrate", "discover", "locate", "compensate", "push", "iso9283", "check", "certificate")
"""Verbs that store results in a run, in the order in which ``show`` names them."""

ALL = (
    *("run", "demo", "doctor", "init", "plan", "rehearse", "collect", "import_"),
    *STORING,
    *("report", "show", "export", "correct", "at_rest", "runs", "compare"),
    *("schema", "docs", "emulate", "tracker_bridge"),
)
_HERE = Path(__file__).parent


def name_of(verb: str) -> str:
    """Return the verb's name on the command line."""
    return verb.rstrip("_").replace("_", "-")


def records(verbs: Sequence[str] = ALL) -> tuple[Verb, ...]:
    """Return the records of verbs; imports them."""
    return tuple(import_module(f"cellapp.commands.{_module(verb)}").VERB for verb in verbs)


def help_of(verb: str) -> str:
    """Return the help of a verb, its request's docstring, from the source: importing all of them would be slow."""
    source = _HERE.joinpath(*_module(verb).split(".")).with_suffix(".py").read_text(encoding="utf-8")
    declared = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    request = next(node for node in declared if any(ast.unparse(base) == "Request" for base in node.bases))
    return ast.get_docstring(request) or ""


def _module(verb: str) -> str:
    """Return the module with a verb's request and record: its only file, or ``request`` in its folder."""
    return verb if (_HERE / f"{verb}.py").is_file() else f"{verb}.request"
