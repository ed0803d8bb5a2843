"""``python -m tests.handbook``: renew the parts of chapters that repeat the code.

``python -m tests.handbook pages RUN DIR`` takes pictures of a run's pages, ``screens PROFILE RUN DIR`` of the terminal
application with it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.handbook.chapters import CHAPTERS, ROOT, chapter_path
from tests.handbook.declarations import with_declarations
from tests.handbook.page_pictures import write_pictures
from tests.handbook.screen_pictures import write_screens


def renew() -> None:
    """Declared parts, where they stand."""
    for chapter in CHAPTERS:
        path = ROOT / chapter_path(chapter)
        text = path.read_text("utf-8")
        if (renewed := with_declarations(text)) != text:
            path.write_text(renewed, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            renew()
        case ["pages", run, folder]:
            write_pictures(Path(run), Path(folder))
        case ["screens", profile, run, folder]:
            write_screens(Path(profile), Path(run), Path(folder))
        case _:
            sys.exit("python -m tests.handbook [pages RUN DIR | screens PROFILE RUN DIR]")
