"""The folders of the verbs, in the order of the work; a new verb is a folder and a word here. Loads none of them."""

from __future__ import annotations

import ast
from pathlib import Path

STORING = (
    "calibrate",
    "discover",
    "locate",
    "compensate",
    "push",
    "follow",
    "iso9283",
    "check",
    "certificate",
)
"""Verbs that store results in a run, in the order in which ``show`` names them."""

FOLDERS = (
    *("run", "demo", "doctor", "init", "plan", "power", "rehearse", "collect", "replay", "import_", "touch"),
    *(*STORING, "sign_key"),
    *("check_certificate", "report", "show", "export", "correct", "at_rest", "runs", "compare", "fleet"),
    *("recalibrate", "schema", "docs", "emulate", "tracker_bridge"),
)


def name_of(folder: str) -> str:
    """Return the verb as it is typed."""
    return folder.rstrip("_").replace("_", "-")


def help_of(folder: str) -> str:
    """Return the help of a verb, the docstring of its request, from the source: its types take too long to load for a
    list."""
    source = (Path(__file__).parent / folder / "request.py").read_text(encoding="utf-8")
    declared = [node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    request = next(node for node in declared if any(ast.unparse(base) == "Request" for base in node.bases))
    return ast.get_docstring(request) or ""
