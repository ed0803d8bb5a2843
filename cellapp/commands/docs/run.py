"""The verb ``docs``: show a part of the handbook, its topics, or the JSON schemas of the results."""

from __future__ import annotations

from cellapp.commands.docs.handbook import PARTS, effect_sections, search, sections, topic_text
from cellapp.commands.docs.request import DocsRequest
from cellapp.commands.record import Request, View, Work
from cellapp.ground.results import Result


class DocsResult(Result, schema="cellapp-docs", version=2):
    """``docs``: a chapter or section of the handbook as Markdown."""

    topic: str
    text: str


class SchemaResult(Result, schema="cellapp-schema"):
    """``docs --schema``: JSON schemas as a text, which is its JSON, too."""

    has_own_schema = False
    text: str

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the schemas themselves."""
        return self.text


def run(request: DocsRequest, work: Work) -> DocsResult | SchemaResult:
    """Find the requested topic."""
    if request.as_schema:
        from cellapp.commands.docs.schema import schemas_text  # late: it imports the results of every verb

        return SchemaResult(text=schemas_text(request.topic))
    if request.words is not None:
        lines = [f"{one.address}\n  {one.line_with(request.words)}" for one in search(request.words)]
        return DocsResult(topic="", text="\n".join(lines) or f"no section has all of these words: {request.words}")
    if request.topic is None:
        return DocsResult(topic="", text=_topics())
    return DocsResult(topic=request.topic, text=topic_text(request.topic))


def _topics() -> str:
    lines = []
    for part, chapters in PARTS.items():
        lines += [f"{part}:", *(f"  {name:12} {sections(name)[0].heading}" for name in chapters), ""]
    return "\n".join([*lines, "or an effect:", *(f"  {slug}" for slug in effect_sections())])


def view(result: DocsResult | SchemaResult, request: Request | None = None) -> View:
    """Show the text."""
    return View((result.text.rstrip("\n"),), is_json=isinstance(result, SchemaResult))
