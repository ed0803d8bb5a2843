"""``python -m tests.handbook.draw figures|pages``: the handbook's figures of effects, frames and obstacles; its pages.

``figures --out DIR`` draws them for the arms of ``--profile``; ``pages --run DIR --out DIR`` takes pictures of the
pages of a run with a certificate and tests by ISO 9283, by Playwright and a Chromium. Files there are replaced.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.ground.outputs import RENEWED
from tests.handbook.figure_files import write_figures
from tests.handbook.page_pictures import write_pictures

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.handbook.draw", description=__doc__)
    parser.add_argument("topic", choices=("figures", "pages"))
    parser.add_argument("--profile", type=Path, default=Path("profiles/twin.yaml"))
    parser.add_argument("--run", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    if asked.topic == "figures":
        paths = write_figures(load_profile(asked.profile), asked.out, RENEWED)
    elif asked.run is None:
        parser.error("pages need --run DIR")
    else:
        paths = write_pictures(asked.run, asked.out, outputs=RENEWED)
    sys.stdout.write(f"{len(paths)} {asked.topic} in {asked.out}\n")
