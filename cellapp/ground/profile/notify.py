"""The profile's section ``notify``: a command of the user's that is run when a job stops, waits or ends."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.quantities import Time
from drivers.settings import Section

NotifyEvent = Literal["stopped", "waiting", "done"]
"""``stopped``: the arms were stopped, or the job failed. ``waiting``: it is paused or suspended. ``done``: it ended."""
EVENTS: tuple[NotifyEvent, ...] = ("stopped", "waiting", "done")

Word = Annotated[str, Field(min_length=1)]


class Notify(Section):
    """What is run, on which events, and after which time it is killed.

    ``command`` is the program and its arguments, one text each; no shell reads them. In each argument ``{event}``,
    ``{text}`` and ``{run}`` stand for the event, a sentence, and the folder of the run; the environment has them as
    ``CELLAPP_EVENT``, ``CELLAPP_TEXT`` and ``CELLAPP_RUN``.
    """

    command: Annotated[tuple[Word, ...], Field(min_length=1)]
    events: Annotated[tuple[NotifyEvent, ...], Field(min_length=1)] = EVENTS
    timeout: Annotated[Time, Field(gt=0.0, le=300.0)] = 30.0
