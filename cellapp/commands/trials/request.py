"""Requests of the verbs ``trials seal``, ``trials judge`` and ``trials power``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, ProfilePath, Request, Verb
from cellapp.ground.outputs import Writes

_Jobs = Annotated[
    int | None, Field(ge=1, le=1024), Asked("Processes, each of one thread; all cores if left out; 1: no other.", "N")
]
_Scheduler = Annotated[
    str | None, Asked("Compute on the workers of a Dask scheduler, as tcp://HOST:8786.", metavar="ADDRESS")
]


class SealRequest(Request):
    """Write runs of simulated cells whose hidden effects are stated in a sealed file only."""

    profile: ProfilePath
    out: Annotated[Path, Asked("New folder of the trials.", "DIR", writes=Writes.OWN_FOLDER)]
    n: Annotated[int, Field(ge=1), Asked("Runs.")] = 200
    seed: Annotated[int | None, Field(ge=0), Asked("Fixes all that is random; left out, a secret one is taken.")] = None
    kind: Annotated[str, Asked("What is hidden: one, none, outside, pair, triple, hard, mixed.", "KIND")] = "one"
    laws: Annotated[str, Asked("same: shaped as the library's; other: by other shapes.", "LAWS")] = "same"
    stops: Annotated[int | None, Asked("Stops of each run, instead of the profile's.")] = None
    ranges: Annotated[str, Asked("full, or narrow: every joint moves over 10 to 50 deg.", "RANGES")] = "full"
    unstated: Annotated[bool, Asked("Readings do not state their uncertainty.")] = False
    plan: Annotated[str, Asked("How stops are chosen: random or designed.", "PLAN")] = "random"


class JudgeRequest(Request):
    """Calibrate and discover on every sealed run, then open the truth and compare; continues where it was stopped."""

    folder: Annotated[Path, Asked("The folder of the trials.", "DIR", argument=True)]
    again: Annotated[bool, Asked("Judge again also what was judged before.")] = False
    jobs: _Jobs = None
    scheduler: _Scheduler = None


class PowerRequest(Request):
    """Before measuring: which effects of which size a cell, its plan and its tracker would have named."""

    where: Annotated[Path, Asked("The cell, as YAML, or a run, which keeps the result.", "PROFILE|DIR", argument=True)]
    trials: Annotated[int, Field(ge=8, le=400), Asked("Trials of each effect and arm.")] = 16
    minutes: Annotated[float, Field(ge=0.1), Asked("Time; what fits is shared among the effects.")] = 10.0
    seed: Annotated[int, Field(ge=0), Asked("Fixes laws, true geometry and noise.")] = 0
    jobs: _Jobs = None
    scheduler: _Scheduler = None
    results: Annotated[
        Path | None, Asked("Keep trials in FILE; what it holds is not repeated.", "FILE", writes=Writes.STORE)
    ] = None


VERBS = (
    Verb("trials seal", SealRequest, chapter="scale"),
    Verb("trials judge", JudgeRequest, chapter="scale"),
    Verb("trials power", PowerRequest, chapter="planning"),
)
