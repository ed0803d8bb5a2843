"""The verb ``collect``: measure the planned stops of a run."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from cellapp.cell.driving.cell_checks import Hung
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.records import CollectResult
from cellapp.cell.driving.requests import running_job
from cellapp.cell.run import RunFile
from cellapp.commands.collect.request import CollectRequest
from cellapp.commands.confirm import Ask, confirmation
from cellapp.commands.locate.station import refuse_second_station
from cellapp.commands.record import Work
from cellapp.commands.rehearse.result import keep_log
from cellapp.ground.control import JobControl
from cellapp.ground.counting import listed_numbers
from cellapp.ground.progress import Listener, ignore, with_eta
from cellapp.ground.threads import one_blas_thread


def run(request: CollectRequest, work: Work) -> CollectResult:
    """Measure the planned stops of the run."""
    with RunFile.open(request.folder, write=True) as opened:
        again = None if request.again is None else [stop - 1 for stop in listed_numbers(request.again, "stops")]
        return collect_stops(
            opened,
            work.listener,
            work.control,
            resume=request.resume,
            accept_drift=request.accept_drift,
            again=again,
            ask=work.ask(opened.profile.name),
            payload=request.payloads,
            hung=hanging(work),
        )


def collect_stops(
    run: RunFile,
    listener: Listener = ignore,
    control: JobControl | None = None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
    again: Collection[int] | None = None,
    ask: Ask | None = None,
    payload: Mapping[str, float] | None = None,
    hung: Hung | None = None,
) -> CollectResult:
    """Measure the planned stops. ``ask`` is called before the first motion of real arms; ``hung`` where the plan needs
    another load, unless ``payload`` says that it is mounted [kg].

    Raises as ``collect_run`` and ``confirmation`` do, and ``InputError`` if another job runs in the folder.
    """
    control = control or JobControl()
    with running_job(run, control, "collect", listener) as listener:
        return collect_planned(
            run,
            listener,
            control,
            ask,
            resume=resume,
            accept_drift=accept_drift,
            again=again,
            payload=payload,
            hung=hung,
        )


def collect_planned(
    run: RunFile,
    listener: Listener,
    control: JobControl,
    ask: Ask | None,
    *,
    resume: bool = False,
    accept_drift: bool = False,
    again: Collection[int] | None = None,
    payload: Mapping[str, float] | None = None,
    hung: Hung | None = None,
) -> CollectResult:
    """Measure as ``collect_stops`` does, within a job that has locked the folder already."""
    refuse_second_station(run)
    missing = keep_log(run)
    confirm = confirmation(run.profile, ask if ask is None or not missing else lambda words: ask(f"{words}\n{missing}"))
    report = with_eta(listener)
    with one_blas_thread():
        result = collect_run(
            run,
            report,
            control,
            resume=resume,
            accept_drift=accept_drift,
            again=again,
            confirm=confirm,
            payload=payload,
            hung=hung,
        )
    return result.model_copy(update={"notes": (*result.notes, *([missing] if missing else []))})


def hanging(work: Work) -> Hung:
    """Return the callable that asks the interface's user to mount another load."""
    return lambda words: work.choose(f"{words} Does it hang?", ("no", "yes")) == "yes"
