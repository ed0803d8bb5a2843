"""The verb ``collect``: measure the planned stops of a run."""

from __future__ import annotations

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.records import CollectResult
from cellapp.cell.driving.requests import running_job
from cellapp.cell.run import RunFile
from cellapp.commands.collect.request import CollectRequest
from cellapp.commands.confirm import confirmation
from cellapp.commands.record import Work
from cellapp.commands.rehearse.result import keep_log
from cellapp.commands.station import refuse_second_station
from cellapp.ground.counting import listed_numbers
from cellapp.ground.threads import one_blas_thread


def run(request: CollectRequest, work: Work) -> CollectResult:
    """Measure the planned stops of the run."""
    with RunFile.open(request.folder, write=True) as opened, running_job(opened, work.control, "collect"):
        return collect_planned(opened, request, work)


def collect_planned(run: RunFile, request: CollectRequest, work: Work) -> CollectResult:
    """Measure the planned stops, within a job that has locked the folder.

    Raises as ``collect_run`` and ``confirmation`` do.
    """
    refuse_second_station(run)
    missing, ask = keep_log(run), work.ask(run.profile.name)
    again = None if request.again is None else [stop - 1 for stop in listed_numbers(request.again, "stops")]
    confirm = confirmation(run.profile, ask if ask is None or not missing else lambda words: ask(f"{words}\n{missing}"))
    with one_blas_thread():
        result = collect_run(
            run,
            work.control,
            resume=request.resume,
            accept_drift=request.accept_drift,
            again=again,
            confirm=confirm,
            payload=request.payloads,
            hung=lambda words: work.choose(f"{words} Does it hang?", ("no", "yes")) == "yes",
        )
    return result.model_copy(update={"notes": (*result.notes, *([missing] if missing else []))})
