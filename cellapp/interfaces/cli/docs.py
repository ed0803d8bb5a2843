"""``docs``: print a part of the handbook, draw its figures, or draw the screens of the terminal application."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption

FIGURES, SCREENS, PAGES = "figures", "screens", "pages"
"""The topics that draw with ``--out``; the first one is a chapter, too."""


def docs(
    topic: Annotated[
        str | None,
        typer.Argument(
            metavar="TOPIC",
            help="A chapter or an effect; with --out 'figures', 'screens' or 'pages'. Without one: all topics.",
        ),
    ] = None,
    profile: Annotated[
        Path, typer.Option("--profile", metavar="PROFILE", help="With figures or screens: the cell that is drawn.")
    ] = Path("profiles/twin.yaml"),
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="With figures, screens or pages: folder of the files."),
        Writes.FOLDER,
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="With screens or pages: a run that they show.")
    ] = None,
    words: Annotated[
        str | None, typer.Option("--search", metavar="WORDS", help="List the sections that have all of these words.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the handbook: a chapter, or the section of one effect; or draw effects, screens, pages of a run."""
    from cellapp.commands.docs.handbook import CHAPTERS, effect_sections, topic_text
    from cellapp.commands.docs.result import DocsResult

    if out is not None and topic not in (FIGURES, SCREENS, PAGES):
        raise InputError(f"docs: --out belongs to '{FIGURES}', '{SCREENS}' and '{PAGES}'")
    if run is not None and topic not in (SCREENS, PAGES):
        raise InputError(f"docs: --run belongs to '{SCREENS}' and '{PAGES}'")
    if words is not None and topic is not None:
        raise InputError("docs: --search looks through the whole handbook; give it without a topic")
    with Job(json_file) as job:
        if words is not None:
            _search(job, words)
        elif topic in (SCREENS, PAGES) or (topic == FIGURES and out is not None):
            _draw(job, topic, profile, run, out)
        elif topic is None:
            lines = [f"{name:12} {subject}" for name, subject in CHAPTERS.items()]
            lines += ["", "draw into a folder, with --out DIR:"]
            lines += [f"  {FIGURES:10} the figures of effects, frames and obstacles"]
            lines += [f"  {SCREENS:10} the screens of the terminal application"]
            lines += [f"  {PAGES:10} pictures of the pages of a run, with --run DIR", ""]
            lines += ["or an effect:", *(f"  {slug}" for slug in effect_sections())]
            job.say(*lines)
            job.result(DocsResult(topic="", text="\n".join(lines)))
        else:
            text = topic_text(topic)
            job.say(text.rstrip("\n"))
            job.result(DocsResult(topic=topic, text=text))


def _search(job: Job, words: str) -> None:
    from cellapp.commands.docs.result import DocsResult
    from cellapp.commands.docs.sections import search

    lines = [f"{hit.section.address}\n  {hit.line}" for hit in search(words)]
    text = "\n".join(lines) or f"no section has all of these words: {words}"
    job.say(text)
    job.result(DocsResult(topic="", text=text))


def _draw(job: Job, topic: str, profile: Path, run: Path | None, out: Path | None) -> None:
    from cellapp.cell.profile import load_profile
    from cellapp.commands.docs.result import DocsResult
    from cellapp.interfaces.tui.pictures import write_screens
    from tests.handbook.figure_files import write_figures
    from tests.handbook.page_pictures import write_pictures

    if out is None:
        raise InputError(f"docs: '{topic}' needs --out DIR, the folder to draw them in")
    if topic == FIGURES:
        paths = write_figures(load_profile(profile), out, job.outputs)
    elif topic == SCREENS:
        paths = write_screens(profile, run, out, outputs=job.outputs)
    elif run is None:
        raise InputError(f"docs: '{PAGES}' needs --run DIR, a run with a page, a certificate and tests by ISO 9283")
    else:
        paths = write_pictures(run, out, outputs=job.outputs)
    job.say(f"{len(paths)} {topic} in {out}")
    job.result(DocsResult(topic=topic, files=tuple(str(path) for path in paths)))
