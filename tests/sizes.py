"""Lines of code by group: without blanks, comments, docstrings and imports.

    python -m tests.sizes

prints them as a table.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).parent.parent
GROUPS = ("interfaces", "commands", "cell", "estimation", "robot", "ground")
_NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
    tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(text: str) -> int:
    """Lines of a Python text that hold code."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and not (
            isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        ):
            continue
        if isinstance(node, ast.Expr | ast.Import | ast.ImportFrom):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def sizes_table() -> str:
    """The table in Markdown: files and lines of each group, of all of ``cellapp``, and of the drivers."""
    rows = ["| group | files | lines of code |", "| --- | --- | --- |"]
    for name, folder in (
        *((group, f"cellapp/{group}") for group in GROUPS),
        ("cellapp", "cellapp"),
        ("drivers", "drivers"),
    ):
        files = list((ROOT / folder).rglob("*.py"))
        lines = sum(code_lines(file.read_text("utf-8")) for file in files)
        rows.append(f"| `{name}` | {len(files)} | {lines} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(sizes_table())
