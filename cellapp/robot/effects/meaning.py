"""What an effect means for whoever runs the cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

SizeSource = Literal["sourced", "computed", "estimate", "none"]

_FRAMES = {"base": "the base", "tool": "the target on the flange", "tracker": "the tracker's reading"}


@dataclass(frozen=True)
class Meaning:
    """Where an effect comes from, how large it usually is, what to check or mend, and what would settle it.

    Texts may hold ``{place}``, for which ``at`` puts the joints or the frame that the effect acts on.

    Attributes
    ----------
    cause : str
        Where it comes from.
    size : str
        How large it usually is at the SMR of arms of this class.
    size_source : "sourced", "computed", "estimate" or "none"
        Read in a publication or catalogue; computed from such figures; an engineer's estimate; or there is no size.
    check : tuple of str
        What to check or mend on the machine, the most likely first.
    settle : tuple of str
        Further stops or observations that would settle whether it is there.
    """

    cause: str
    size: str
    size_source: SizeSource
    check: tuple[str, ...]
    settle: tuple[str, ...]

    def at(self, place: str) -> Meaning:
        """The same with the place in words, for example ``joints 2 and 3``: texts then speak of ``each of`` them."""
        one = f"each of {place}" if place.startswith(("joints ", "links ")) else place

        def fill(text: str) -> str:
            filled = text.replace("{place}", one)
            return filled[:1].upper() + filled[1:]

        return replace(
            self,
            cause=fill(self.cause),
            size=fill(self.size),
            check=tuple(map(fill, self.check)),
            settle=tuple(map(fill, self.settle)),
        )


def enumeration(words: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def place_in_words(acts_on: Sequence[str]) -> str:
    """``joints 2 and 3``, ``link 2``, ``the base`` for the names of what columns act on."""
    for kind in ("joint", "link"):
        if acts_on and all(name.startswith(f"{kind} ") for name in acts_on):
            numbers = [name.removeprefix(f"{kind} ") for name in acts_on]
            return f"{kind}{'s' if len(numbers) > 1 else ''} {enumeration(numbers)}"
    return enumeration([_FRAMES.get(name, name) for name in acts_on])
