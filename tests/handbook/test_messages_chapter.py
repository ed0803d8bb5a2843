"""The chapter on messages quotes what the program says: every quoted message stands in its source."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from cellapp.commands.docs.handbook import chapter_text

pytestmark = pytest.mark.fast

ROOT = Path(__file__).parents[2]
SPEAKING = ("drivers/arms", "drivers/trackers", "cellapp/cell/driving", "cellapp/cell/safety")
"""Folders whose messages the chapter explains."""
OTHERS = ("cellapp/commands/stages.py", "cellapp/ground/errors.py", "cellapp/interfaces/cli/program.py")
GAP = "..."
"""Stands in the chapter for what changes from case to case; here for the values in an f-string."""


def spoken() -> str:
    """All texts of the modules that have messages, one a line."""
    modules = [*(ROOT / name for name in OTHERS), *(path for name in SPEAKING for path in (ROOT / name).rglob("*.py"))]
    nodes = [node for module in modules for node in ast.walk(ast.parse(module.read_text("utf-8")))]
    texts = [node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            texts.append("".join(str(part.value) if isinstance(part, ast.Constant) else GAP for part in node.values))
    return "\n".join(texts)


def quoted() -> list[str]:
    """Messages in the tables whose first column is what the program says."""
    tables = re.findall(r"^\| the program says .*\n(?:\|.*\n)+", chapter_text("messages"), re.MULTILINE)
    rows = [row.split("|")[1] for table in tables for row in table.splitlines()[2:]]
    return [message for row in rows for message in re.findall(r"`([^`]+)`", row)]


@pytest.mark.slow
def test_every_quoted_message_is_one_that_the_program_has() -> None:
    texts = spoken()
    messages = quoted()
    assert len(messages) > 40
    parts = {part.strip() for message in messages for part in re.split(r"\.\.\.|[;:(] ?", message)}
    assert not [part for part in parts if part not in texts]
