"""``pause``, ``resume``, ``stop``, ``abort`` as they are asked in a shell. Imports little, see ``cellapp.asking``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cellapp.asking import VERBS, Verb, ask_running_job
from cellapp.errors import CellappError

_EXPANDED = frozenset("*?[~$%")
"""Characters that the command line expands on Windows."""


class JobRequest(NamedTuple):
    """What is asked, of the job in which folder, and where the answer goes as JSON."""

    verb: Verb
    folder: Path
    json_file: str | None = None


def plain_request(arguments: Sequence[str]) -> JobRequest | None:
    """The request that the arguments of the program make; None where the whole command line has to read them."""
    if not arguments or arguments[0] not in VERBS or any(_EXPANDED & {*word} for word in arguments):
        return None
    words, json_file = list(arguments[1:]), None
    if "--json" in words[:-1]:
        place = words.index("--json")
        json_file = words[place + 1]
        del words[place : place + 2]
    if len(words) != 1 or words[0].startswith("-") or ((json_file or "").startswith("-") and json_file != "-"):
        return None
    return JobRequest(arguments[0], Path(words[0]), json_file)


def ask_job(request: JobRequest) -> None:
    """Send a request to a running job, then print its answer, and as JSON where that is wanted.

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
    """Write a ``RequestResult``, without that class: a test compares the two."""
    found = {"schema": "cellapp-request", "version": 1, "run": str(request.folder)}
    text = json.dumps({**found, "request": request.verb, "answer": answer}, indent=1, ensure_ascii=False)
    if json_file == "-":
        print(text, flush=True)
        return
    try:
        Path(json_file).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise CellappError(f"--json: {json_file} cannot be written ({error.strerror})") from None
