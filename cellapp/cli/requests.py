"""``pause``, ``resume``, ``stop`` and ``abort``: requests to the job that runs in a run's folder."""

from __future__ import annotations

from pathlib import Path

from cellapp.cli.job import Job
from cellapp.cli.options import JsonOption, RunFolder
from cellapp.control import Verb


def pause(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Let the job that runs in DIR finish the present stop, then wait with the arms at rest."""
    _ask(folder, "pause", json_file)


def resume(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Let a paused job continue, or a stopped one that waits for it."""
    _ask(folder, "resume", json_file)


def stop(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Brake all arms of the job that runs in DIR now. It can be resumed."""
    _ask(folder, "stop", json_file)


def abort(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Brake all arms of the job that runs in DIR now, and end the job."""
    _ask(folder, "abort", json_file)


def _ask(folder: Path, verb: Verb, json_file: str | None) -> None:
    from cellapp.commissioning.job_requests import ask_running_job

    answer = ask_running_job(folder, verb)  # before anything else: nothing may delay a stop
    with Job(json_file) as job:
        job.say(answer)
        if json_file is not None:
            from cellapp.results import RequestResult

            job.result(RequestResult(run=str(folder), request=verb, answer=answer))
