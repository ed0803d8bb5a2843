"""``python -m tests.handbook``: draw the figures of the handbook, and renew the parts of chapters that repeat the code.

``python -m tests.handbook figures PROFILE DIR`` draws the figures for another arm, ``pages RUN DIR`` pages of a run,
``screens PROFILE RUN DIR`` the terminal application with it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.ground.outputs import RENEWED
from tests.handbook.chapters import CHAPTERS, ROOT, chapter_path
from tests.handbook.declarations import with_declarations
from tests.handbook.figure_files import write_figures
from tests.handbook.page_pictures import write_pictures
from tests.handbook.screen_pictures import write_screens

FIGURES = ROOT / "cellapp" / "docs" / "figures"


def renew() -> None:
    """Figures and declared parts, where they stand."""
    write_figures(load_profile(ROOT / "profiles" / "twin.yaml"), FIGURES, RENEWED)
    for chapter in CHAPTERS:
        path = ROOT / chapter_path(chapter)
        text = path.read_text("utf-8")
        if (renewed := with_declarations(text)) != text:
            path.write_text(renewed, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            renew()
        case ["figures", profile, folder]:
            write_figures(load_profile(Path(profile)), Path(folder), RENEWED)
        case ["pages", run, folder]:
            write_pictures(Path(run), Path(folder), outputs=RENEWED)
        case ["screens", profile, run, folder]:
            write_screens(Path(profile), Path(run), Path(folder))
        case _:
            sys.exit("python -m tests.handbook [figures PROFILE DIR | pages RUN DIR | screens PROFILE RUN DIR]")
