"""What a probe of a device reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warning", "failed"]


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    Attributes
    ----------
    subject : str
        What was checked, in a word or two; empty for the device as a whole.
    status : {"ok", "warning", "failed"}
        Whether a job can start; a warning does not prevent it.
    text : str
        What was found and, unless it is ok, what to do.
    """

    subject: str
    status: Status
    text: str
