"""The one function that every worker calls: from the texts of a task to the text of its answer."""

from __future__ import annotations

import json
import platform
import sys
import threading
import time
import traceback
from functools import lru_cache
from pathlib import Path
from typing import Any

from cellapp.ground.errors import CellappError, CheckFailed
from cellapp.ground.results import Record
from cellapp.ground.scale.program import Program, this_program
from cellapp.ground.scale.task import TaskKind, as_json, load_kind
from cellapp.ground.threads import one_blas_thread

_MOST_PREPARED = 2
"""Batches whose shared part a process keeps ready."""
_ONE_AT_A_TIME = threading.Lock()
"""A Dask worker may have several threads; the limit of threads of linear algebra holds for the whole process."""


class Answer(Record):
    """What became of one task.

    Attributes
    ----------
    found : str, optional
        The result as JSON; None if the task failed.
    failure : str
        Why it failed, in a sentence; empty if it did not.
    refused : bool
        Whether the worker did not begin: it is of another program.
    exit_code : int
        Of the command, if all tasks fail like this one.
    cpu_s, wall_s : float
        Processor time of the thread and wall time [s], without what the process prepares once a batch.
    peak_mb : float, optional
        Largest memory that the process has had so far [MB]; None where the system does not say.
    """

    found: str | None = None
    failure: str = ""
    refused: bool = False
    exit_code: int = CheckFailed.exit_code
    cpu_s: float = 0.0
    wall_s: float = 0.0
    peak_mb: float | None = None


def perform(kind: str, common: str, parameters: str, program: str) -> str:
    """Compute one task; all arguments and the returned ``Answer`` are text.

    ``program`` is the caller's; a worker of another one refuses.
    """
    asked = Program.model_validate_json(program)
    if asked != this_program():
        here = f"the worker on {platform.node()} runs {this_program().words}, this program is {asked.words}"
        return as_json(Answer(failure=f"{here}; install the same on both", refused=True))
    with _ONE_AT_A_TIME, one_blas_thread():
        return as_json(_answer(kind, common, parameters))


def _answer(kind: str, common: str, parameters: str) -> Answer:
    try:
        its, prepared = _prepared(kind, common)
        wall_s, cpu_s = time.perf_counter(), time.thread_time()
        found = its.run(prepared, its.parameters.model_validate_json(parameters))
        return Answer(
            found=json.dumps(found.model_dump(by_alias=True), separators=(",", ":")),
            wall_s=time.perf_counter() - wall_s,
            cpu_s=time.thread_time() - cpu_s,
            peak_mb=_peak_mb(),
        )
    except CellappError as error:
        return Answer(failure=str(error), exit_code=error.exit_code)
    except Exception as error:  # noqa: BLE001 - one task that fails, of many, is reported with its place
        place = traceback.extract_tb(error.__traceback__)[-1]
        return Answer(failure=f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})")


@lru_cache(maxsize=_MOST_PREPARED)
def _prepared(kind: str, common: str) -> tuple[TaskKind[Any, Any, Any, Any], Any]:
    its = load_kind(kind)
    return its, its.prepare(its.common.model_validate_json(common))


def _peak_mb() -> float | None:
    if sys.platform == "win32":
        return None
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
