"""Request of the verb ``schema``."""

from __future__ import annotations

from typing import Annotated

from cellapp.commands.record import Asked, Request, Verb


class SchemaRequest(Request):
    """Print the JSON schemas of the results, by the name that their JSON carries under "schema"."""

    name: Annotated[str | None, Asked("One result, as cellapp-calibrate.", "NAME", argument=True)] = None


VERB = Verb("schema", SchemaRequest, chapter="commands")
