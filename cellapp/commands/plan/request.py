"""Request of the verb ``plan``: a new plan, a plan from a file, a plan to edit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cellapp.commands.record import Asked, Request, Verb

MOST_STOPS = 100_000


class PlanRequest(Request):
    """Plan the stops of a run: visible to the tracker, safe to stand at and to reach.

    'plan PROFILE --run DIR' designs a new plan; 'plan PROFILE --from CSV' checks an edited one, and with --run makes
    the run of it; 'plan --edit --run DIR' changes the plan of a run. 'cellapp export DIR --plan CSV' writes a plan.
    """

    profile: Annotated[Path | None, Asked("The cell, as YAML.", "PROFILE", argument=True)] = None
    folder: Annotated[
        Path | None,
        Asked(
            "Folder of the new run; with --edit that of the run to change.",
            "DIR",
            option="--run",
            label="folder of the run",
            hint="empty: only check the table",
        ),
    ] = None
    sweeps: Annotated[
        int | None,
        Field(ge=1, le=MOST_STOPS),
        Asked(
            "Of a new plan: N stops, and at each of them a recorded sweep of every arm.", "N", label="stops with sweeps"
        ),
    ] = None
    source: Annotated[
        Path | None,
        Asked(
            "Take the plan exactly as it is written; without --run only check it.",
            "CSV",
            option="--from",
            label="stops of table",
            hint="empty: designed",
            suffixes=(".csv",),
        ),
    ] = None
    keep: Annotated[
        bool, Asked("freeze its stops and design the rest around them.", label="design the rest", of="source")
    ] = False
    edit: Annotated[bool, Asked("Change the plan of the run --run, by the profile in it.")] = False
    add: Annotated[
        int | None,
        Field(ge=1, le=MOST_STOPS),
        Asked("append N stops.", "N", label="further stops", hint=f"1 to {MOST_STOPS}", of="edit"),
    ] = None
    replan: Annotated[
        bool, Asked("design the stops that are not measured again.", label="design the rest again", of="edit")
    ] = False
    freeze: Annotated[
        str | None,
        Asked(
            "stops, as 1-10,13, that later designs leave.", "LIST", label="freeze", hint="1-10,13, or none", of="edit"
        ),
    ] = None

    def job_name(self) -> str:
        if self.source is not None and self.folder is None:
            return "check"
        return "freeze" if self.freeze is not None else ""

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        if self.edit and self.source is not None:
            raise ValueError("--from and --edit do not go together; give one of them")
        if self.sweeps is not None and (self.edit or self.source is not None):
            raise ValueError("--sweeps belongs to a new plan; give it without --from and --edit")
        if self.edit and (self.profile is not None or self.folder is None):
            raise ValueError("--edit changes the plan of a run by the profile in it: give --run DIR and no PROFILE")
        if self.edit and (self.add is not None) + self.replan + (self.freeze is not None) != 1:
            raise ValueError("--edit takes one of --add N, --replan and --freeze LIST")
        if not self.edit and self.profile is None:
            raise ValueError("PROFILE is missing; name the cell's YAML file")
        if self.folder is None and (self.source is None or self.keep):
            raise ValueError("--run DIR is missing; name the folder of the new run")
        return self


VERB = Verb("plan", PlanRequest, chapter="planning", question="Plan stops")
