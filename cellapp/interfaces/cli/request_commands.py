"""``pause``, ``resume``, ``stop``, ``abort`` as regular commands, with help, options and usage errors."""

from __future__ import annotations

from cellapp.interfaces.cli.command_outputs import current_outputs
from cellapp.interfaces.cli.options import JsonOption, RunFolder
from cellapp.interfaces.cli.requests import JobRequest, ask_job


def pause(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Let the job that runs in DIR finish the present stop, then wait with the arms at rest."""
    ask_job(JobRequest("pause", folder, json_file, current_outputs().outputs.force))


def resume(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Let a paused job continue, or a stopped one that waits for it."""
    ask_job(JobRequest("resume", folder, json_file, current_outputs().outputs.force))


def stop(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Brake all arms of the job that runs in DIR now. It can be resumed."""
    ask_job(JobRequest("stop", folder, json_file, current_outputs().outputs.force))


def abort(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Brake all arms of the job that runs in DIR now, and end the job."""
    ask_job(JobRequest("abort", folder, json_file, current_outputs().outputs.force))


REQUESTS = (pause, resume, stop, abort)
