"""What ``show`` found."""

from __future__ import annotations

from typing import Literal

from pydantic import SerializeAsAny

from cellapp.commands.run_results import RunResults
from cellapp.ground.results import Result


class Shown(Result):
    """A part of a run, and what is said of it. Its JSON is that of the part.

    Attributes
    ----------
    part : str
    result : Result or None
        The part itself; None for the profile, whose JSON is ``text``.
    out_of_date, made_by : str
        Why the part no longer holds, and the command that repeats it; empty where it holds.
    results : RunResults or None
        All results of the run, of a target that is shown.
    complaints : tuple of str
        What of the run is out of date, where a strict person asks.
    """

    schema_: Literal["cellapp-shown"] = "cellapp-shown"
    version: Literal[1] = 1
    part: str
    result: SerializeAsAny[Result] | None = None
    text: str = ""
    out_of_date: str = ""
    made_by: str = ""
    results: RunResults | None = None
    complaints: tuple[str, ...] = ()

    def to_json(self, *, indent: int | None = None) -> str:
        """The JSON of the part."""
        return self.text if self.result is None else self.result.to_json(indent=indent)
