"""Request of the verb ``docs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, Verb
from cellapp.ground.outputs import Writes

SCREENS = "screens"
"""Topic that draws pictures into a folder."""


class DocsRequest(Request):
    """Print the handbook: a chapter, or the section of one effect; or draw the screens of the terminal application."""

    topic: Annotated[
        str | None,
        Asked(f"A chapter or an effect; with --out '{SCREENS}'. Without one: all topics.", "TOPIC", argument=True),
    ] = None
    profile: Annotated[Path, Asked(f"With {SCREENS}: the cell that is drawn.", "PROFILE")] = Path("profiles/twin.yaml")
    out: Annotated[Path | None, Asked(f"With {SCREENS}: folder of the files.", "DIR", writes=Writes.FOLDER)] = None
    run: Annotated[Path | None, Asked(f"With {SCREENS}: a run that they show.", "DIR")] = None
    words: Annotated[
        str | None, Asked("List the sections that have all of these words.", "WORDS", option="--search")
    ] = None

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        """Refuse options that belong to another topic."""
        for name in ("out", "run"):
            if getattr(self, name) is not None and self.topic != SCREENS:
                raise ValueError(f"{self.option_of(name)} belongs to '{SCREENS}'")
        if self.topic == SCREENS and self.out is None:
            raise ValueError(f"'{SCREENS}' needs --out DIR, the folder to draw them in")
        if self.words is not None and self.topic is not None:
            raise ValueError("--search looks through the whole handbook; give it without a topic")
        return self


VERB = Verb("docs", DocsRequest, chapter="commands")
