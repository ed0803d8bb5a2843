"""Request of the verb ``compensate``."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import model_validator

from cellapp.commands.record import Asked, Request, RunFolder, Stored, Verb
from cellapp.ground.outputs import Writes

PROGRAMS = (".script", ".urp")
"""Endings of programs of UR controllers."""
_MOTION = re.compile(rb"^[ \t]*(?:def \w+\(|(?:move[jlpc]|set_tcp)\()", re.MULTILINE)
_LOOKED_AT = 2**20
"""Bytes of a file in which its kind shows."""


def program_kind(path: Path) -> str:
    """Return the ending of the kind of UR program that a file is by its content, else by its name; empty if none."""
    suffix, head = path.suffix.lower(), b""
    with suppress(OSError), path.open("rb") as file:
        head = file.read(_LOOKED_AT)
    if head.startswith(b"\x1f\x8b"):  # packed by gzip
        return ".urp"
    if _MOTION.search(head):
        return ".script"
    return suffix if suffix in PROGRAMS and b"schema: cellapp-" not in head else ""


class CompensateRequest(Request):
    """Commands from the calibrated model that bring the real arms to targets, along paths, through a UR program.

    TARGETS is a target list (YAML, CSV), a path file (YAML: lines and arcs with speeds), or a program of a UR
    controller (.script, .urp), known by its content; see 'cellapp docs targets'. The targets of a program are corrected
    so that a plain controller truly reaches them: every other line stays byte for byte, and nothing is written while a
    target cannot be corrected, unless with --partly. Nothing moves.
    """

    folder: RunFolder
    targets: Annotated[
        Path | tuple[Any, ...],
        Asked("Target list (.yaml, .csv), path file (.yaml) or UR program (.script, .urp).", "TARGETS", argument=True),
    ]
    out: Annotated[
        Path | None,
        Asked(
            "Of paths: joint positions over time, .csv, or URScript, .script, a file for each arm. Of a program: the"
            " corrected copy, of the same kind.",
            "FILE",
            label="corrected copy",
            suffixes=PROGRAMS,
            writes=Writes.FILES,
        ),
    ] = None
    arm: Annotated[str | None, Asked("Of a program: whose it is; needed with several arms.", "NAME", label="arm")] = (
        None
    )
    tcp: Annotated[
        str | None,
        Asked(
            "Of a program: TCP in the flange frame [m, rad], if it sets none.",
            "X,Y,Z,RX,RY,RZ",
            label="TCP",
            unit="m, rad",
            hint="x,y,z,rx,ry,rz; empty: the program's set_tcp",
        ),
    ] = None
    partly: Annotated[
        bool,
        Asked(
            "Of a program: write although some targets cannot be corrected; they stay as they are.",
            label="write although some targets cannot be corrected",
        ),
    ] = False
    extrapolate: Annotated[
        bool,
        Asked(
            "Of a program: correct targets outside the joint ranges of the readings too.",
            label="correct outside the joint ranges of the readings too",
        ),
    ] = False
    insignificant: Annotated[
        bool,
        Asked(
            "Of a program: correct targets whose correction is not significant too.",
            label="correct what is not significant too",
        ),
    ] = False

    @cached_property
    def program(self) -> Path | None:
        """The program of a UR controller whose targets are corrected; None for targets and paths."""
        return self.targets if isinstance(self.targets, Path) and program_kind(self.targets) else None

    @model_validator(mode="after")
    def _of_a_program(self) -> Self:
        """Refuse words about a program without one, and a program without the file of its copy."""
        own = ("arm", "tcp", "partly", "extrapolate", "insignificant")
        given = [self.option_of(name) for name in own if getattr(self, name)]
        if given and self.program is None:
            raise ValueError(f"{', '.join(given)}: only for a program of a UR controller, .script or .urp")
        if self.program is not None and self.out is None:
            raise ValueError("--out FILE is missing: the corrected copy of the program")
        return self


VERB = Verb(
    "compensate",
    CompensateRequest,
    chapter="targets",
    question="Correct a program",
    stored=(
        Stored("targets", "no compensated targets are", ("compensate",)),
        Stored("paths", "no paths are", ("path",), view="paths_view"),
    ),
)
