"""Parts of a view: sentences, tables, charts, and sections that hold such parts under a title.

A view lists them in the order of a terminal. The page and the terminal application have room beside and below: they
show the sentences of a section first, then its charts, tables and inner sections.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Union

import numpy as np
from numpy.typing import NDArray

from cellapp.commands.view.charts import Array, mm
from cellapp.commands.view.table import Table
from cellapp.commands.view.words import STAGE_WORDS

if TYPE_CHECKING:
    from cellapp.commands.view.charts import Chart


Part = Union[str, "Facts", "Chart", "CellScene", Table, "Section"]
"""Charts load numpy, which a terminal without charts does not need."""
Parts = Sequence[Part]
_WIDTH = 80
"""Columns of a terminal."""


@dataclass(frozen=True)
class Facts:
    """Pairs of a title and a text; an empty title continues the pair before."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Section:
    """Parts that belong together under a title.

    Attributes
    ----------
    parts : sequence of Part
        Its contents.
    message : str
        The section in one sentence, also shown while it is folded.
    about : str
        What it shows and how to read it, for newcomers.
    folded : bool
        Whether it holds details, which an interface shows on request.
    key : str
        Its anchor on a page; none if empty.
    outdated : str
        Why its results no longer hold; empty if they do.
    """

    title: str
    parts: Parts
    message: str = ""
    about: str = ""
    folded: bool = False
    key: str = ""
    outdated: str = ""


def printed(parts: Parts, depth: int = 0) -> Iterator[Table | str]:
    """Yield lines and tables in their order for plain text: without charts, details and explanations.

    The contents of a section are indented below its title and wrapped for a terminal of 80 columns.
    """
    for part in parts:
        if isinstance(part, Section):
            inside = [] if part.folded else [*filter(None, [part.message]), *part.parts]
            body = list(printed(inside, depth + 1))
            yield from (*_indented(part.title, depth), *body, *([] if depth else [""])) if body else ()
        elif isinstance(part, Facts):
            for title, text in part.rows:
                yield from _indented(f"{title}: {text}" if title else f"  {text}", depth)
        elif isinstance(part, str):
            yield from _indented(part, depth) if depth else [part]
        elif isinstance(part, Table):
            yield part


def _indented(text: str, depth: int) -> list[str]:
    first = "  " * depth + text[: len(text) - len(text.lstrip())]
    return textwrap.wrap(text.strip(), _WIDTH, initial_indent=first, subsequent_indent=f"{first}  ")


def sentence(text: str) -> str:
    """Make a sentence of words: add a capital letter and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")


def section_of(title: str, parts: Parts, *, message: str = "", about: str = "") -> Section:
    """Build a section; its default message is the first sentence of its parts."""
    if not message:
        first = next(place for place, part in enumerate(parts) if isinstance(part, str))
        message, parts = str(parts[first]), [*parts[:first], *parts[first + 1 :]]
    return Section(title, parts, sentence(message), about)


# ---------------------------------------------------------------------------------------------------------------------
# The cell in space as data: arms, bases, tracker, obstacles, measured stops, errors before and after. No drawing.


@dataclass(frozen=True, eq=False)
class Capsules:
    """The bodies of one arm: capsules with axes from ``start`` to ``end`` (m, 3) [m] and ``radius`` (m,) [m]."""

    start: Array
    end: Array
    radius: Array


@dataclass(frozen=True, eq=False)
class ErrorVectors:
    """Measured minus computed positions ``steps`` (n, 3) [m] of one stage at held-out ``points`` (n, 3) [m]."""

    stage: str
    points: Array
    steps: Array
    stops: NDArray[np.int64]

    @property
    def mean_mm(self) -> float:
        """Mean length [mm]."""
        return float(np.linalg.norm(self.steps, axis=1).mean()) * 1e3 if len(self.steps) else 0.0


@dataclass(frozen=True, eq=False)
class SceneArm:
    """One arm: its bodies and its chain (k, 3) [m] from base to SMR at one measured stop, measured ``points`` (n, 3)
    [m] at ``stops`` (n,), and its errors before and after."""

    name: str
    base: Array
    chain: Array
    bodies: Capsules
    points: Array
    stops: NDArray[np.int64]
    errors: tuple[ErrorVectors, ...]


@dataclass(frozen=True, eq=False)
class CellScene:
    """The cell in the tracker frame, rotated so that z points up; the tracker is at the origin.

    ``obstacles`` are points (n, 3) [m] by name, drawn as their convex hulls. ``enlarged`` is the factor by which errors
    are drawn larger.
    """

    arms: tuple[SceneArm, ...]
    obstacles: Mapping[str, Array]
    enlarged: float

    @cached_property
    def points(self) -> Array:
        """Points (n, 3) [m] of arms, stops and tracker: what a picture must show."""
        parts = [part for arm in self.arms for part in (arm.points, arm.chain, arm.bodies.start, arm.bodies.end)]
        return np.vstack([np.zeros((1, 3)), *parts])

    @property
    def message(self) -> str:
        """Sentence on the distances of the arms from the tracker, and on how much smaller the errors became."""
        sentences = []
        for arm in self.arms:
            words = f"Arm {arm.name} stands {float(np.linalg.norm(arm.base)):.1f} m from the tracker"
            if arm.errors:
                before, after = arm.errors[0], arm.errors[-1]
                words += f"; its mean error at held-out stops is {mm(before.mean_mm)} ({STAGE_WORDS[before.stage]})"
                if after is not before:
                    words += f" before and {mm(after.mean_mm)} ({STAGE_WORDS[after.stage]}) after"
            sentences.append(f"{words}.")
        return " ".join(sentences)
