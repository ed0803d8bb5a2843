"""Folders of the verbs, in the order of the work; a new verb is a folder and a word here. Imports none of them."""

from __future__ import annotations

import ast
from pathlib import Path

STORING = (
    "calibrate",
    "discover",
    "locate",
    "compensate",
    "push",
    "iso9283",
    "check",
    "certificate",
)
"""Verbs that store results in a run, in the order in which ``show`` names them."""

FOLDERS = (
    *("run", "demo", "doctor", "init", "plan", "rehearse", "collect", "import_"),
    *STORING,
    *("report", "show", "export", "correct", "at_rest", "runs", "compare"),
    *("schema", "docs", "emulate", "tracker_bridge"),
)


def name_of(folder: str) -> str:
    """Return the verb's name on the command line."""
    return folder.rstrip("_").replace("_", "-")


def help_of(folder: str) -> str:
    """Return the help of a verb, its request's docstring, from the source: importing all requests would be slow."""
    source = (Path(__file__).parent / folder / "request.py").read_text(encoding="utf-8")
    declared = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    request = next(node for node in declared if any(ast.unparse(base) == "Request" for base in node.bases))
    return ast.get_docstring(request) or ""
