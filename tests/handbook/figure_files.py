"""All figures of the handbook that are drawn from the models, as files."""

from __future__ import annotations

from pathlib import Path

from cellapp.cell.profile.files import write_new
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.ground.profile import Profile
from tests.evidence import more_readings
from tests.evidence.skeleton import stated_results
from tests.handbook import frame_figures, planning_figures
from tests.handbook.effect_figures import FIGURES, figure_svg
from tests.handbook.scene import Scene


def write_figures(profile: Profile, folder: Path, outputs: Outputs = NEW_ONLY) -> list[Path]:
    """Draw the figures of effects for the first arm of a profile, of its obstacles and frames, as SVG; their paths.

    Raises
    ------
    InputError
        If the folder cannot be written, or the profile lacks a pose that the figures need.
    """
    scene = Scene.of(profile)
    texts = {slug: figure_svg(slug, scene) for slug in FIGURES}
    texts[planning_figures.FIGURE] = planning_figures.figure_svg(profile)
    texts[more_readings.FIGURE] = more_readings.figure_svg(stated_results()["more_readings"])
    texts |= {stem: frame_figures.figure_svg(stem, profile) for stem in frame_figures.FIGURES}
    return list(write_new({folder / f"{stem}.svg": text for stem, text in texts.items()}, outputs))
