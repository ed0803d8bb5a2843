"""The verb ``docs``: show a part of the handbook or its topics, or draw pictures of the screens."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.docs.handbook import PARTS, effect_sections, search, topic_text
from cellapp.commands.docs.request import SCREENS, DocsRequest
from cellapp.commands.record import Request, View, Work
from cellapp.ground.results import Result


class DocsResult(Result, schema="cellapp-docs"):
    """``docs``: a chapter or section of the handbook as Markdown, or the files that were drawn."""

    topic: str
    text: str | None = None
    files: tuple[str, ...] = ()


def run(request: DocsRequest, work: Work) -> DocsResult:
    """Find or draw the requested topic."""
    if request.words is not None:
        lines = [f"{hit.section.address}\n  {hit.line}" for hit in search(request.words)]
        return DocsResult(topic="", text="\n".join(lines) or f"no section has all of these words: {request.words}")
    if request.topic is None:
        return DocsResult(topic="", text=_topics())
    if request.topic != SCREENS or request.out is None:
        return DocsResult(topic=request.topic, text=topic_text(request.topic))
    paths = work.screens(request.profile, request.run, request.out)
    return DocsResult(topic=SCREENS, files=tuple(str(path) for path in paths))


def _topics() -> str:
    lines = []
    for part, chapters in PARTS.items():
        lines += [f"{part}:", *(f"  {name:12} {subject}" for name, subject in chapters.items()), ""]
    lines += ["draw into a folder, with --out DIR:", f"  {SCREENS:10} the screens of the terminal application", ""]
    return "\n".join([*lines, "or an effect:", *(f"  {slug}" for slug in effect_sections())])


def view(result: DocsResult, request: Request | None = None) -> View:
    """Show the text, or how many files were drawn where."""
    if result.text is not None:
        return View((result.text.rstrip("\n"),))
    return View((f"{len(result.files)} {result.topic} in {Path(result.files[0]).parent}",))
