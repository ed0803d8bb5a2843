"""Result of ``init``."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Result


class InitResult(Result):
    """``init``: the profile that was written, and what is to be known about it; ``readings`` are the converted ones."""

    schema_: Literal["cellapp-init"] = "cellapp-init"
    version: Literal[1] = 1
    profile: str
    notes: tuple[str, ...] = ()
    readings: str | None = None
    omitted_when_none = frozenset({"readings"})
