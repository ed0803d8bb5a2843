"""Request of the verb ``touch``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import field_validator, model_validator

from cellapp.commands.fields import ProfilePath
from cellapp.commands.record import Asked, Request, Verb

WORDS = ("undo", "end")
"""Words typed instead of a socket's name."""
LONGEST = 60
"""Most characters of a socket's name."""


class TouchRequest(Request):
    """Record an arm that you lead by hand with a ball in sockets: its joints at rest, by a key. Nothing is moved.

    Names of sockets are read line by line: put the ball into the socket, let go, type its name and Enter. Enter alone:
    the same socket again; undo: take the last touch back; end, or the end of the input: done. A run that is there is
    gone on with.
    """

    profile: ProfilePath
    folder: Annotated[Path, Asked("Folder of the run, new or begun by 'touch'.", "DIR", option="--run")]
    arm: Annotated[
        str | None,
        Asked("The arm that is led; may be left out where there is one.", "NAME", label="arm", hint="the only one"),
    ] = None
    point: Annotated[
        str | None,
        Asked("Record one touch of this socket, and end.", "SOCKET", label="socket", hint="name of the socket"),
    ] = None
    sure: Annotated[
        bool,
        Asked(
            "With --point: also if it lies far from the other touches of the socket.",
            label="also if far from the others of its socket",
        ),
    ] = False
    undo: Annotated[bool, Asked("Take the arm's last touch back, and end.", label="take the last touch back")] = False
    on_flange: Annotated[
        bool,
        Asked(
            "The socket is on the other arm's flange: both arms are led, and both arms' joints are recorded.",
            label="socket on the other arm's flange",
        ),
    ] = False
    distances: Annotated[Path | None, Asked("Known distances between sockets, stored at the end.", "FILE")] = None

    @field_validator("point")
    @classmethod
    def _name(cls, name: str | None) -> str | None:
        return None if name is None else socket_name(name)

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        if self.undo and self.point is not None:
            raise ValueError(
                "a socket's name and undo exclude each other; leave the name out to take the last touch back"
            )
        if self.sure and self.point is None:
            raise ValueError("--sure belongs to --point; line by line you are asked")
        if self.on_flange and self.distances is not None:
            raise ValueError("--distances are between sockets that stand still; give them without --on-flange")
        return self


def socket_name(text: str) -> str:
    """Check a socket's name. Raises ``ValueError`` with what is wrong."""
    name = text.strip()
    if not name:
        raise ValueError("the name of the socket is empty; expected a name as front_0")
    if name in WORDS:
        raise ValueError(f"'{name}' is no name of a socket: it is a word of this command")
    if len(name) > LONGEST or not name.isprintable():
        raise ValueError(f"expected a name of at most {LONGEST} printable characters, as front_0")
    return name


VERB = Verb("touch", TouchRequest, chapter="sockets", question="Record a touch?")
