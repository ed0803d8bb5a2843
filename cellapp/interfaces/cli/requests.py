"""Fast path of ``stop`` and ``job pause``, ``resume``, ``abort`` from a shell. Few imports (``ground.job_client``)."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cellapp.ground.job_client import VERBS, Verb, ask_running_job

_FORCE = "--force"
REMEDY = f"add {_FORCE} to replace it"
_EXPANDED = frozenset("*?[~$%")
"""Characters that the command line expands on Windows."""


class JobRequest(NamedTuple):
    """A request, the folder of the job, and the JSON destination of the answer; ``force``: replace an existing file."""

    verb: Verb
    folder: Path
    json_file: str | None = None
    force: bool = False


def plain_request(arguments: Sequence[str]) -> JobRequest | None:
    """Parse a plain request from the program's arguments; None if the whole command line must parse them."""
    word, *words = arguments or ("",)
    if word == "job" and words[:1] != ["stop"]:
        word, *words = words or ("",)
    elif word != "stop":
        return None
    if word not in VERBS or any(_EXPANDED & {*one} for one in words):
        return None
    json_file = None
    if "--json" in words[:-1]:
        place = words.index("--json")
        json_file = words[place + 1]
        del words[place : place + 2]
    force = _FORCE in words
    if force:
        words.remove(_FORCE)
    if len(words) != 1 or words[0].startswith("-") or ((json_file or "").startswith("-") and json_file != "-"):
        return None
    return JobRequest(word, Path(words[0]), json_file, force)


def ask_job(request: JobRequest) -> None:
    """Send a request to a running job and print its answer, also as JSON if requested.

    Raises
    ------
    CellappError
        If the request was not carried out; or it was, and its answer cannot be written as JSON.
    """
    answer = ask_running_job(request.folder, request.verb)
    print(answer, file=sys.stderr if request.json_file == "-" else sys.stdout, flush=True)
    if request.json_file is not None:
        _write_json(request, request.json_file, answer)


def _write_json(request: JobRequest, json_file: str, answer: str) -> None:
    """Write a ``RequestResult`` without importing that class; a test compares the two."""
    found = {"schema": "cellapp-request", "version": 1, "run": str(request.folder)}
    text = json.dumps({**found, "request": request.verb, "answer": answer}, indent=1, ensure_ascii=False)
    if json_file == "-":
        print(text, flush=True)
        return
    from cellapp.ground.outputs import Outputs  # imported after the request was sent: it may be a stop

    Outputs(request.force, remedy=REMEDY).write_text(Path(json_file), text + "\n", "--json")
