"""The verbs as jobs of the terminal application. Packages that a verb needs are loaded in the job's thread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellapp.commands.record import Ask, Request, Verb, Work
from cellapp.commands.run.request import VERB as RUN
from cellapp.ground.control import JobControl
from cellapp.interfaces.page import certificate_page, write_page
from cellapp.interfaces.tui.jobs import Job

if TYPE_CHECKING:
    from cellapp.commands.init.request import InitRequest
    from cellapp.ground.profile import Profile
    from cellapp.ground.results import Result


def verb_job(verb: Verb, request: Request) -> Job:
    """Return the job of a verb."""

    def work(control: JobControl, ask: Ask) -> Result:
        given = Work(
            control,
            lambda profile_name: ask,
            choose=lambda question, answers: answers[-1] if verb.moves_arms and ask(question) else "",
            write_page=write_page,
            certificate_page=certificate_page,
        )
        return verb.run(request, given)

    folder = getattr(request, "folder", None)
    name = request.job_name() or verb.name
    return Job(name, work, folder, moves=verb.moves_arms, verb=verb, request=request)


def job_of(verb: Verb, **values: Any) -> Job:
    """Return the job of a verb, with these values of its request's fields."""
    return verb_job(verb, verb.asked(values))


def whole_day(profile: Path, folder: Path, agreed: Profile) -> Job:
    """Return the job of a whole day: plan, collect, calibrate, discover, compensate, verify, report.

    ``agreed`` is the profile that the person agreed to; the job refuses a file that has changed since.
    """
    job = job_of(RUN, profile=profile, folder=folder)

    def work(control: JobControl, ask: Ask) -> Result | None:
        from cellapp.cell.profile import load_profile
        from cellapp.ground.errors import InputError

        if load_profile(profile) != agreed:
            raise InputError(f"{profile} was edited since it was read; it is read again now, then F5 asks again")
        return job.work(control, ask)

    return replace(job, work=work)


def own_readings(request: InitRequest) -> Job:
    """Return the job that creates profile and run from external readings, in the folders of both."""
    assert request.readings is not None
    folder = request.folder / "logs" / request.readings.stem.lower().replace(" ", "-")

    def work(control: JobControl, ask: Ask) -> Result:
        from cellapp.cell.profile import load_profile
        from cellapp.commands.import_ import ImportRequest, import_new_run
        from cellapp.commands.init.own_data import InitResult
        from cellapp.commands.init.request import VERB as INIT
        from cellapp.commands.init.run import view
        from cellapp.ground.errors import InputError

        written = verb_job(INIT, request).work(control, ask)
        assert isinstance(written, InitResult)
        if written.readings is None:  # a recording of motion
            raise InputError(str(view(written).parts[-1]))
        profile = Path(written.profile)
        imported = import_new_run(
            load_profile(profile), ImportRequest(profile=profile, csv=Path(written.readings), folder=folder)
        )
        return imported.model_copy(update={"notes": (*written.notes, *imported.notes)})

    return Job("import", work, folder)


def words_of_run(folder: Path) -> str:
    """Return a run and what remains of it, in words. Call it in a separate thread."""
    from cellapp.commands.runs.run import summarise
    from cellapp.ground.counting import counted

    run = summarise(folder)
    if run.resumable:
        return f"{folder}: {counted(run.stops_left, 'stop')} left"
    return f"{folder}: in use by {run.in_use}" if run.in_use else str(folder)
