"""The commands in the order of the work, in panels. A new verb is a file or a folder here, and a word below.

None is imported before somebody asks for its record: a small verb brings all that it needs to run.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellapp.commands.record import Verb

STORING = ("calibrate", "discover", "compensate", "push", "check", "iso9283", "certificate")
"""Verbs that store results in a run, in the order in which ``show`` names them."""

PANELS: Mapping[str, tuple[str, ...]] = {
    "Start": ("init", "doctor", "run"),
    "Measure": ("plan", "rehearse", "collect", "import_"),
    "Identify": ("calibrate", "discover"),
    "Use": ("compensate", "push", "export"),
    "Accept": ("check", "iso9283", "certificate", "report"),
    "Runs": ("show", "runs"),
    "A running job": ("stop", "job"),
    "Develop": ("emulate", "tracker_bridge", "trials", "docs"),
}
"""Title of each panel of the help -> its commands."""
PANEL: Mapping[str, str] = {word: title for title, words in PANELS.items() for word in words}
ALL = tuple(word for word in PANEL if word != "stop")
"""Words of the verbs; ``stop`` has no record."""
GROUPS: Mapping[str, str] = {
    "job": "Ask the job that runs in DIR to pause, resume or abort; say that you have seen an arm at rest.",
    "trials": "Effects hidden in a simulated cell of yours: which of which size would be named?",
}
"""Words of several verbs, which follow it -> its help."""
MOVES = "ARMS MOVE. "
"""Begins the help of a command that moves arms."""
_HERE = Path(__file__).parent


def name_of(verb: str) -> str:
    """Return the verb's name on the command line."""
    return verb.rstrip("_").replace("_", "-")


def records(verbs: Sequence[str] = ALL) -> tuple[Verb, ...]:
    """Return the records of verbs, of a group those of each; imports them."""
    modules = [import_module(f"cellapp.commands.{_module(verb)}") for verb in verbs]
    return tuple(one for module in modules for one in getattr(module, "VERBS", None) or (module.VERB,))


def help_of(verb: str) -> str:
    """Return the help of a verb's command from the source: importing all of them would be slow."""
    if verb in GROUPS:
        return GROUPS[verb]
    source = _HERE.joinpath(*_module(verb).split(".")).with_suffix(".py").read_text(encoding="utf-8")
    declared = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    request = next(node for node in declared if any(ast.unparse(base) == "Request" for base in node.bases))
    return (MOVES if "moves_arms=True" in source else "") + (ast.get_docstring(request) or "")


def _module(verb: str) -> str:
    """Return the module with a verb's request and record: its only file, or ``request`` in its folder."""
    return verb if (_HERE / f"{verb}.py").is_file() else f"{verb}.request"
