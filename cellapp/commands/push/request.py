"""Request of the verb ``push``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cellapp.commands.record import Asked, OutOfDate, Request, RunFolder, Stored, TargetsPath, Verb

MOST_ROUNDS = 20
"""Most corrections of one target: each more than halves the remaining error, so further ones only follow the noise."""


class PushRequest(Request):
    """Move the arms to compensated targets; with --verify, measure them before and after compensation."""

    folder: RunFolder
    targets: TargetsPath
    verify: Annotated[bool, Asked("Measure where the SMR really goes.")] = False
    iterate: Annotated[
        int | None,
        Field(ge=1, le=MOST_ROUNDS),
        Asked(
            "correct the position that remains, not the rotation, at most N times a target.",
            "N",
            label="corrections",
            hint=f"of each target by measuring it, 1 to {MOST_ROUNDS}; empty: none",
            of="verify",
        ),
    ] = None
    out_of_date: OutOfDate = False

    def job_name(self) -> str:
        return "verify" if self.verify else ""


VERB = Verb(
    "push",
    PushRequest,
    chapter="targets",
    moves_arms=True,
    question="Push and verify?",
    checks="verification",
    stored=(Stored("verification", "no verification is", ("verify",), "push --verify"),),
)
