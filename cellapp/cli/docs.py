"""``docs``: print a part of the handbook, or draw its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.cli.job import Job
from cellapp.cli.options import JsonOption
from cellapp.errors import InputError

FIGURES = "figures"
"""The topic that draws instead of printing."""


def docs(
    topic: Annotated[
        str | None,
        typer.Argument(metavar="TOPIC", help="A chapter, an effect's name, or 'figures'; without one: all topics."),
    ] = None,
    profile: Annotated[
        Path, typer.Option("--profile", metavar="PROFILE", help="With figures: the cell whose first arm is drawn.")
    ] = Path("profiles/twin.yaml"),
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="With figures: folder of the files.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the handbook: a chapter, or the section of one effect; or draw the figures of the effects."""
    from cellapp.docs.handbook import CHAPTERS, effect_sections, topic_text
    from cellapp.results import DocsResult

    if out is not None and topic != FIGURES:
        raise InputError("docs: --out belongs to 'figures'")
    with Job(json_file) as job:
        if topic == FIGURES:
            _draw(job, profile, out)
        elif topic is None:
            lines = [f"{name:12} {subject}" for name, subject in CHAPTERS.items()]
            lines += [f"{FIGURES:12} draws the figures of the effects; needs --out DIR", ""]
            lines += ["or an effect:", *(f"  {slug}" for slug in effect_sections())]
            job.say(*lines)
            job.result(DocsResult(topic="", text="\n".join(lines)))
        else:
            text = topic_text(topic)
            job.say(text.rstrip("\n"))
            job.result(DocsResult(topic=topic, text=text))


def _draw(job: Job, profile: Path, out: Path | None) -> None:
    from cellapp.docs.handbook import write_figures
    from cellapp.profile import load_profile
    from cellapp.results import DocsResult

    if out is None:
        raise InputError("docs: 'figures' needs --out DIR, the folder to draw them in")
    paths = write_figures(load_profile(profile), out)
    job.say(f"{len(paths)} figures in {out}")
    job.result(DocsResult(topic=FIGURES, files=tuple(str(path) for path in paths)))
