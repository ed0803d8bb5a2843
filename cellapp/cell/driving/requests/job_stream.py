"""Messages from a job to those who watch it: lines of JSON, each an object whose key ``type`` names its class.

Always use ``encode`` and ``decode`` for these lines; numbers are preserved exactly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from operator import index
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex, get_args

from cellapp.ground.asking import Verb
from cellapp.ground.control import Aborted, Request
from cellapp.ground.errors import CellappError, HardwareError
from cellapp.ground.progress import Cancelled, CellLive, Detail, Progress

if TYPE_CHECKING:
    from pydantic import TypeAdapter

_TYPE = "type"


@dataclass(frozen=True)
class Heartbeat:
    """State of a job, sent at least every 0.2 s.

    Attributes
    ----------
    name : str
        What the job does, as one word: "collect".
    request : str
        The last request of a person that is still in force.
    holds : bool
        Whether the job waits after a halt for ``resume`` or ``abort``; if not, it ends.
    has_brakes : bool
        Whether arms are open that a stop would brake.
    ends : bool
        Whether the job was asked to end.
    live : CellLive or None
        Present state of its cell; None if no cell is open.
    """

    name: str
    request: Request
    holds: bool
    has_brakes: bool
    ends: bool
    live: CellLive | None = None


@dataclass(frozen=True)
class Answer:
    """Answer to a request from the stream: whether it was carried out, and a sentence."""

    verb: Verb | Literal["look", "watch", "unknown"]
    carried_out: bool
    text: str


@dataclass(frozen=True)
class Ending:
    """Last line: how the job ended; if it failed, the error's message and exit code."""

    how: Literal["done", "stopped", "aborted", "failed"]
    text: str = ""
    exit_code: int = 0


Line = Progress | Heartbeat | Answer | Ending


def ending_of(error: BaseException | None) -> Ending:
    """Return the ending of a job that raised ``error``, or succeeded if None."""
    if error is None:
        return Ending("done")
    if isinstance(error, Aborted):
        return Ending("aborted", str(error), 4)
    if isinstance(error, Cancelled):
        return Ending("stopped", str(error), 4)
    if isinstance(error, CellappError):
        return Ending("failed", str(error), error.exit_code)
    return Ending("failed", f"unexpected {type(error).__name__}: {error}", HardwareError.exit_code)


def encode(line: Line) -> bytes:
    """Return one line, including its end-of-line character."""
    return json.dumps(line, default=_plain).encode() + b"\n"


def decode(line: bytes) -> Line:
    """Parse one line. Raise ``ValueError`` if it is not one that ``encode`` writes."""
    found = json.loads(line)
    try:
        if found.get("detail") is not None:
            found["detail"] = _object(found["detail"])
        made = _object(found)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"no line of a job: {line[:80]!r}") from error
    if not isinstance(made, Line):
        raise ValueError(f"no line of a job: {line[:80]!r}")
    return made


def _plain(value: object) -> object:
    if is_dataclass(value):
        return {_TYPE: type(value).__name__, **vars(value)}
    if isinstance(value, SupportsIndex):  # numpy's integers
        return index(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} in a line of a job")


def _object(found: Mapping[str, Any]) -> object:
    return _adapters()[found[_TYPE]].validate_python(found)


@cache
def _adapters() -> Mapping[str, TypeAdapter[Any]]:
    """Return the pydantic adapter of each class by its name; built once, on first use."""
    from pydantic import TypeAdapter

    return {kind.__name__: TypeAdapter(kind) for kind in (*get_args(Detail), *get_args(Line))}
