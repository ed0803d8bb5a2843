"""The handbook's chapters, the sections of single effects, and what these repeat of the effects' declarations."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from cellapp.docs import planning_figures
from cellapp.docs.effect_figures import FIGURES, figure_svg
from cellapp.docs.scene import Scene
from cellapp.effects import EFFECTS, Effect
from cellapp.errors import InputError
from cellapp.profile import Profile

CHAPTERS: Mapping[str, str] = {
    "effects": "the physical effects that discovery knows",
    "discovery": "how discovery decides, and what its words mean",
    "planning": "which stops are measured, obstacles, editing a plan",
    "signature": "an arm calibrated again, with its earlier calibration as prior",
    "terminal": "the terminal application: a day, its screens and its keys",
    "targets": "targets of calibrated arms: lists, verdicts, uncertainty, measuring them",
    "exports": "calibrated arms for other programs, and what their files cannot hold",
    "paths": "lines and arcs that the true SMR follows: the file, driving, measuring",
    "programs": "programs of UR controllers, corrected so that the real arm reaches their targets",
}
"""Name and subject of each chapter, a Markdown file of this package."""
_SECTION = re.compile(r"^## (\w+)$", re.MULTILINE)
_DECLARED = re.compile(r"<!-- declared: (\w+) -->\n.*?<!-- end -->\n", re.DOTALL)
_WIDTH = 120
"""Columns of the Markdown files."""
_MARKER = re.compile(r"<!--.*?-->\n")
_GENERAL_PLACE = {"link_bending": "the link", "unknown": "a part of the cell"}


def topics() -> list[str]:
    """Names of the chapters and of the effects that have a section."""
    return [*CHAPTERS, *effect_sections()]


def topic_text(topic: str) -> str:
    """Markdown of a chapter, or of the section of one effect, without the markers.

    Raises
    ------
    InputError
        If there is no such topic.
    """
    known = topics()
    if topic not in known:
        raise InputError(f"docs: '{topic}' is not a topic; topics are {', '.join(known)}")
    return _MARKER.sub("", chapter_text(topic) if topic in CHAPTERS else effect_sections()[topic])


def chapter_text(chapter: str) -> str:
    """A chapter as it is kept, with the markers around the parts that repeat declarations."""
    return resources.files("cellapp.docs").joinpath(f"{chapter}.md").read_text("utf-8")


def effect_sections() -> dict[str, str]:
    """Section of each effect in the chapter on effects, by slug."""
    text = chapter_text("effects")
    found = list(_SECTION.finditer(text))
    ends = [*(match.start() for match in found[1:]), len(text)]
    return {match[1]: text[match.start() : end] for match, end in zip(found, ends, strict=True)}


def with_declarations(text: str) -> str:
    """The text with the parts that repeat an effect's declarations (between markers) renewed from them."""
    return _DECLARED.sub(lambda match: declared_part(EFFECTS[match[1]]), text)


def declared_part(effect: Effect) -> str:
    """Usual size, checks and further stops of an effect as Markdown, with the markers around them."""
    meaning = effect.meaning.at(_GENERAL_PLACE.get(effect.slug, "the joint"))
    known = "" if meaning.size_source == "none" else f" ({meaning.size_source})"
    parts = [
        _wrapped(f"**Cause.** {meaning.cause}"),
        _wrapped(f"**Usual size**{known}. {meaning.size}."),
        "**Check or mend**",
        "\n".join(_wrapped(f"- {line}") for line in meaning.check),
        "**What settles it**",
        "\n".join(_wrapped(f"- {line}") for line in meaning.settle),
    ]
    return f"<!-- declared: {effect.slug} -->\n" + "\n\n".join(parts) + "\n<!-- end -->\n"


def _wrapped(text: str) -> str:
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(text, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def write_figures(profile: Profile, folder: Path) -> list[Path]:
    """Draw the figure of every effect for the first arm of a profile, and that of obstacles, as SVG; their paths.

    Raises
    ------
    InputError
        If the folder cannot be written, or the profile lacks a pose that the figures need.
    """
    scene = Scene.of(profile)
    texts = {slug: figure_svg(slug, scene) for slug in FIGURES}
    texts[planning_figures.FIGURE] = planning_figures.figure_svg(profile)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stem, text in texts.items():
            (folder / f"{stem}.svg").write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"docs: {folder}: {error.strerror or error}; give a folder that can be written") from None
    return [folder / f"{stem}.svg" for stem in texts]
