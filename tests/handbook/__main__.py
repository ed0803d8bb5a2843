"""``python -m tests.handbook``: renew the parts of the chapters that repeat declarations of the code."""

from pathlib import Path

from cellapp.commands.docs.handbook import CHAPTERS
from tests.handbook.declarations import with_declarations

if __name__ == "__main__":
    for chapter in CHAPTERS:
        path = Path(__file__).parents[2] / "cellapp" / "docs" / f"{chapter}.md"
        text = path.read_text("utf-8")
        if (renewed := with_declarations(text)) != text:
            path.write_text(renewed, encoding="utf-8", newline="\n")
