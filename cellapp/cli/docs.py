"""``docs``: print a part of the handbook, draw its figures, or draw the screens of the terminal application."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.cli.job import Job
from cellapp.cli.options import JsonOption
from cellapp.errors import InputError

FIGURES, SCREENS = "figures", "screens"
"""The topics that draw instead of printing."""


def docs(
    topic: Annotated[
        str | None,
        typer.Argument(
            metavar="TOPIC", help="A chapter, an effect's name, 'figures' or 'screens'; without one: all topics."
        ),
    ] = None,
    profile: Annotated[
        Path, typer.Option("--profile", metavar="PROFILE", help="With figures or screens: the cell that is drawn.")
    ] = Path("profiles/twin.yaml"),
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="With figures or screens: folder of the files.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="With screens: a run that they show.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the handbook: a chapter, or the section of one effect; or draw the effects, or the screens."""
    from cellapp.docs.handbook import CHAPTERS, effect_sections, topic_text
    from cellapp.results import DocsResult

    if out is not None and topic not in (FIGURES, SCREENS):
        raise InputError(f"docs: --out belongs to '{FIGURES}' and '{SCREENS}'")
    if run is not None and topic != SCREENS:
        raise InputError(f"docs: --run belongs to '{SCREENS}'")
    with Job(json_file) as job:
        if topic in (FIGURES, SCREENS):
            _draw(job, topic, profile, run, out)
        elif topic is None:
            lines = [f"{name:12} {subject}" for name, subject in CHAPTERS.items()]
            lines += [f"{FIGURES:12} draws the figures of the effects; needs --out DIR"]
            lines += [f"{SCREENS:12} draws the screens of the terminal application; needs --out DIR", ""]
            lines += ["or an effect:", *(f"  {slug}" for slug in effect_sections())]
            job.say(*lines)
            job.result(DocsResult(topic="", text="\n".join(lines)))
        else:
            text = topic_text(topic)
            job.say(text.rstrip("\n"))
            job.result(DocsResult(topic=topic, text=text))


def _draw(job: Job, topic: str, profile: Path, run: Path | None, out: Path | None) -> None:
    from cellapp.docs.handbook import write_figures
    from cellapp.profile import load_profile
    from cellapp.results import DocsResult
    from cellapp.tui.pictures import write_screens

    if out is None:
        raise InputError(f"docs: '{topic}' needs --out DIR, the folder to draw them in")
    paths = write_figures(load_profile(profile), out) if topic == FIGURES else write_screens(profile, run, out)
    job.say(f"{len(paths)} {topic} in {out}")
    job.result(DocsResult(topic=topic, files=tuple(str(path) for path in paths)))
