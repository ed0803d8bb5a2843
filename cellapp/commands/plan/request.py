"""Request of the verb ``plan``: a new plan, a plan from a file, a file to check, a plan to extend or to redo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.commands.record import Asked, Request, Verb

MOST_STOPS = 100_000


class PlanRequest(Request):
    """Plan the stops of a run: visible to the tracker, safe to stand at and to reach.

    'cellapp export DIR --plan FILE' writes a plan as CSV, to be edited by hand.
    """

    profile: Annotated[Path | None, Asked("The cell, as YAML.", "PROFILE", argument=True)] = None
    folder: Annotated[
        Path | None,
        Asked(
            "Folder of the new run; with --add, --replan, --freeze that of the run to change.", "DIR", option="--run"
        ),
    ] = None
    source: Annotated[
        Path | None, Asked("Take the plan from FILE exactly as it is written.", "FILE", option="--from")
    ] = None
    keep: Annotated[Path | None, Asked("Freeze the stops of FILE; design the rest around.", "FILE")] = None
    check: Annotated[Path | None, Asked("Only check the plan in FILE; exit code 1 if unsafe.", "FILE")] = None
    add: Annotated[
        int | None,
        Field(ge=1, le=MOST_STOPS),
        Asked("Append N stops to the plan of a run.", "N", label="further stops", hint=f"1 to {MOST_STOPS}"),
    ] = None
    replan: Annotated[bool, Asked("Design the stops of a run that are not measured again.")] = False
    freeze: Annotated[str | None, Asked("Configurations, as 0-9,12, that later designs of the run leave.", "LIST")] = (
        None
    )
    sweeps: Annotated[
        int | None,
        Field(ge=1, le=MOST_STOPS),
        Asked("Plan N stops, and at each of them a recorded sweep of every arm.", "N"),
    ] = None

    def job_name(self) -> str:
        named = {"check": self.check is not None, "freeze": self.freeze is not None}
        return next((name for name, is_asked in named.items() if is_asked), "")

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        given = {
            "--from": self.source is not None,
            "--keep": self.keep is not None,
            "--check": self.check is not None,
            "--add": self.add is not None,
            "--replan": self.replan,
            "--freeze": self.freeze is not None,
            "--sweeps": self.sweeps is not None,
        }
        words = [word for word, is_given in given.items() if is_given]
        if len(words) > 1:
            raise ValueError(f"{' and '.join(words)} do not go together; give one of them")
        changes_run = given["--add"] or given["--replan"] or given["--freeze"]
        if changes_run and (self.profile is not None or self.folder is None):
            raise ValueError(
                f"{words[0]} changes the plan of a run by the profile in it: give --run DIR and no PROFILE"
            )
        if not changes_run and self.profile is None:
            raise ValueError("PROFILE is missing; name the cell's YAML file")
        only_reads = given["--check"]
        if only_reads and self.folder is not None:
            raise ValueError(f"{words[0]} makes no run; leave out --run")
        if not (changes_run or only_reads) and self.folder is None:
            raise ValueError("--run DIR is missing; name the folder of the new run")
        return self


VERB = Verb("plan", PlanRequest, chapter="planning", question="How many further stops?")
