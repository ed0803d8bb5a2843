"""Request of the verb ``show``; which parts there are comes from the verbs that store something."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, create_model, model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Strict, Verb
from cellapp.commands.registry import STORING, records
from cellapp.ground.shell import shell_word

OWN_PARTS = ("overview", "plan", "collection", "recordings", "log", "profile", "history")
"""Parts of a run beside the results of verbs."""


class ShowRequest(Request):
    """Print what a run holds; nothing is changed, and only --check and --forecast compute anything."""

    folder: RunFolder
    part: Annotated[str, Asked("What to print.", argument=True)] = "overview"
    level: Annotated[
        Literal["info", "note", "warning", "error"] | None, Asked("With log: only lines of this level.", "WORD")
    ] = None
    last: Annotated[int | None, Field(ge=1), Asked("With log: the last N lines.", "N")] = None
    check: Annotated[bool, Asked("With plan: run the motion check over all stops and ways again.")] = False
    forecast: Annotated[bool, Asked("With plan: time, joint ranges, expected errors, effects it can show.")] = False
    against: Annotated[
        Path | None, Asked("Where this run differs from another one: profile, parameters, effects.", "DIR")
    ] = None
    target: Annotated[str | None, Asked("With targets: all about one of them.", "NAME")] = None
    strict: Strict = False

    def job_name(self) -> str:
        return "plan check" if self.check else "forecast" if self.forecast else ""

    @model_validator(mode="after")
    def _belongs_to_the_part(self) -> Self:
        if self.part != "log" and (self.level is not None or self.last is not None):
            raise ValueError("--level and --last belong to 'log'")
        if (self.check or self.forecast) and (self.part != "plan" or (self.check and self.forecast)):
            of_plan = f"'cellapp show {shell_word(self.folder)} plan"
            raise ValueError(f"--check and --forecast belong to 'plan': {of_plan} --check' or {of_plan} --forecast'")
        if self.part != "targets" and self.target is not None:
            raise ValueError("--target belongs to 'targets'")
        if self.against is not None and self.part != OWN_PARTS[0]:
            raise ValueError(f"--against compares whole runs; give it without '{self.part}'")
        return self


def show_verb(verbs: Sequence[Verb]) -> Verb:
    """Build the record of ``show`` for these verbs; the parts are the results that they store."""
    first, *others = OWN_PARTS
    literal: Any = Literal  # typed as Any: its values are known only at run time
    annotated: Any = Annotated
    parts = literal[(first, *(one.part for verb in verbs for one in verb.stored), *others)]
    asked = next(words for name, words in ShowRequest.asked() if name == "part")
    request = create_model(
        "ShowRequest",
        __base__=ShowRequest,
        __module__=__name__,
        __doc__=ShowRequest.__doc__,
        part=(annotated[parts, asked], first),
    )
    return Verb("show", request, chapter="commands")


VERB = show_verb(records(STORING))
