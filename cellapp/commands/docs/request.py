"""Request of the verb ``docs``."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, Verb


class DocsRequest(Request):
    """Print the handbook: a chapter, the section of one effect, or the JSON schemas of the results."""

    topic: Annotated[str | None, Asked("A chapter or an effect; without one: all topics.", "TOPIC", argument=True)] = (
        None
    )
    as_schema: Annotated[
        bool,
        Asked('JSON schemas by the name that JSON carries under "schema"; of one if TOPIC is it.', option="--schema"),
    ] = False
    words: Annotated[
        str | None, Asked("List the sections that have all of these words.", "WORDS", option="--search")
    ] = None

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        """Refuse a search in one topic."""
        if self.words is not None and self.topic is not None:
            raise ValueError("--search looks through the whole handbook; give it without a topic")
        if self.words is not None and self.as_schema:
            raise ValueError("--search looks through the handbook; give it without --schema")
        return self


VERB = Verb("docs", DocsRequest, chapter="commands")
