"""``docs``: print a part of the handbook, or draw the screens of the terminal application."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.command_outputs import Written
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption

SCREENS = "screens"
"""The topic that draws with ``--out``."""


def docs(
    topic: Annotated[
        str | None,
        typer.Argument(
            metavar="TOPIC",
            help="A chapter or an effect; with --out 'screens'. Without one: all topics.",
        ),
    ] = None,
    profile: Annotated[
        Path, typer.Option("--profile", metavar="PROFILE", help="With screens: the cell that is drawn.")
    ] = Path("profiles/twin.yaml"),
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="With screens: folder of the files."),
        Written.FOLDER,
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="With screens: a run that they show.")
    ] = None,
    words: Annotated[
        str | None, typer.Option("--search", metavar="WORDS", help="List the sections that have all of these words.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Print the handbook: a chapter, or the section of one effect; or draw the screens."""
    from cellapp.commands.docs.handbook import CHAPTERS, effect_sections, topic_text
    from cellapp.commands.run_results import DocsResult

    for option, value in (("--out", out), ("--run", run)):
        if value is not None and topic != SCREENS:
            raise InputError(f"docs: {option} belongs to '{SCREENS}'")
    if words is not None and topic is not None:
        raise InputError("docs: --search looks through the whole handbook; give it without a topic")
    with Job(json_file) as job:
        if words is not None:
            _search(job, words)
        elif topic == SCREENS:
            _draw(job, profile, run, out)
        elif topic is None:
            lines = [f"{name:12} {subject}" for name, subject in CHAPTERS.items()]
            lines += ["", "draw into a folder, with --out DIR:"]
            lines += [f"  {SCREENS:10} the screens of the terminal application", ""]
            lines += ["or an effect:", *(f"  {slug}" for slug in effect_sections())]
            job.say(*lines)
            job.result(DocsResult(topic="", text="\n".join(lines)))
        else:
            text = topic_text(topic)
            job.say(text.rstrip("\n"))
            job.result(DocsResult(topic=topic, text=text))


def _search(job: Job, words: str) -> None:
    from cellapp.commands.docs.sections import search
    from cellapp.commands.run_results import DocsResult

    lines = [f"{hit.section.address}\n  {hit.line}" for hit in search(words)]
    text = "\n".join(lines) or f"no section has all of these words: {words}"
    job.say(text)
    job.result(DocsResult(topic="", text=text))


def _draw(job: Job, profile: Path, run: Path | None, out: Path | None) -> None:
    from cellapp.commands.run_results import DocsResult
    from cellapp.interfaces.tui.pictures import write_screens

    if out is None:
        raise InputError(f"docs: '{SCREENS}' needs --out DIR, the folder to draw them in")
    paths = write_screens(profile, run, out, outputs=job.outputs)
    job.say(f"{len(paths)} {SCREENS} in {out}")
    job.result(DocsResult(topic=SCREENS, files=tuple(str(path) for path in paths)))
