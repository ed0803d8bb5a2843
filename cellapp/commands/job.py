"""The verb ``job confirm-rest``: record that a person saw an arm at rest which counted as moving."""

from __future__ import annotations

from typing import Annotated

from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import BY_PERSON, note_at_rest
from cellapp.commands.record import Asked, Request, RunFolder, Verb, View, Work
from cellapp.ground.job_client import Verb as JobVerb
from cellapp.ground.results import Result


class AtRestRequest(Request):
    """Say that you have seen an arm at rest that a run counts as moving since its stop was not confirmed."""

    folder: RunFolder
    arm: Annotated[str, Asked("The arm, as the profile names it.", "ARM", argument=True)]


VERB = Verb("job confirm-rest", AtRestRequest, chapter="faults")


class RequestResult(Result, schema="cellapp-request"):
    """``stop``, ``job pause``, ``job resume`` and ``job abort``: what the running job was asked, and its answer."""

    run: str
    request: JobVerb
    answer: str


class AtRestResult(Result, schema="cellapp-at-rest"):
    """``job confirm-rest``: the arm that a person has seen at rest, and whether it counted as moving."""

    run: str
    arm: str
    counted_as_moving: bool


def run(request: AtRestRequest, work: Work) -> AtRestResult:
    """Record that the arm was seen at rest."""
    with RunFile.open(request.folder, write=True) as opened:
        counted = note_at_rest(opened, request.arm, BY_PERSON)
    return AtRestResult(run=str(request.folder), arm=request.arm, counted_as_moving=counted)


def view(result: AtRestResult, request: Request | None = None) -> View:
    """Say whether the arm counted as moving before."""
    words = "recorded as seen at rest" if result.counted_as_moving else "it did not count as moving"
    return View((f"arm {result.arm}: {words}",))
