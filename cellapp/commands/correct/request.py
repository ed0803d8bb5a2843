"""Request of the verb ``correct``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cellapp.commands.fields import RunFolder
from cellapp.commands.record import Asked, Request, Verb
from cellapp.ground.outputs import Writes

ENDINGS = (".script", ".urp")


class CorrectRequest(Request):
    """Correct the targets of a UR program by the calibrated model, so that a plain controller truly reaches them.

    Every other line stays byte for byte. Nothing is written while a target cannot be corrected, unless with --partly.
    """

    folder: RunFolder
    program: Annotated[
        Path, Asked("Program of a UR controller: .script or .urp.", "PROGRAM", argument=True, suffixes=ENDINGS)
    ]
    out: Annotated[
        Path,
        Asked(
            "The corrected copy, of the same kind.",
            "FILE",
            label="corrected copy",
            suffixes=ENDINGS,
            writes=Writes.FILES,
        ),
    ]
    arm: Annotated[str | None, Asked("Whose program it is; needed with several arms.", "NAME", label="arm")] = None
    tcp: Annotated[
        str | None,
        Asked(
            "TCP in the flange frame [m, rad], if the program sets none.",
            "X,Y,Z,RX,RY,RZ",
            label="TCP",
            unit="m, rad",
            hint="x,y,z,rx,ry,rz; empty: the program's set_tcp",
        ),
    ] = None
    partly: Annotated[
        bool,
        Asked(
            "Write although some targets cannot be corrected; they stay as they are.",
            label="write although some targets cannot be corrected",
        ),
    ] = False
    extrapolate: Annotated[
        bool,
        Asked(
            "Correct targets outside the joint ranges of the readings too.",
            label="correct outside the joint ranges of the readings too",
        ),
    ] = False


VERB = Verb("correct", CorrectRequest, chapter="programs", question="Correct a program")
