"""Numbers and names as people read and type them."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from decimal import Decimal

from cellapp.ground.errors import InputError

_NUMBERS = re.compile(r"([0-9]{1,6})(?:-([0-9]{1,6}))?")


def counted(count: int, one: str, many: str = "") -> str:
    """``1 stop``, ``3 stops``; ``many`` is the plural where it is not ``one`` with an s, as "stops are"."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"


def first_few(texts: Sequence[str], more: str = "{} more", most: int = 5) -> list[str]:
    """The first of many texts, enough to see a pattern and few enough to read, and how many ``more`` there are."""
    return [*texts[:most], *([more.format(len(texts) - most)] if len(texts) > most else [])]


def mm(value: float) -> str:
    """Format a length [mm] with two or three significant digits, and at most four decimals."""
    if not math.isfinite(value):
        return "unknown"
    decimals = 4 if abs(value) < 0.01 else 3 if abs(value) < 1.0 else 2 if abs(value) < 10.0 else 1
    return f"{value:z.{decimals}f} mm"


def plain(value: float, digits: int = 3) -> str:
    """Format a number with so many significant digits; without an exponent, and never as minus zero."""
    text = f"{value:z.{digits}g}"
    return f"{Decimal(text):f}" if "e" in text else text


def did_you_mean(
    name: str, known: Iterable[str], words: str = "; did you mean '{}'?", *, cutoff: float = 0.6, otherwise: str = ""
) -> str:
    """Put the known name that is most like ``name`` into ``words``; return ``otherwise`` if none is like it."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return words.format(close[0]) if close else otherwise


def listed_numbers(text: str, what: str) -> tuple[int, ...]:
    """The numbers that a text such as ``1-10,13`` lists, ascending; none for ``none``. ``what`` they count, as "stops".

    Raises ``InputError`` if it is no such list.
    """
    found: set[int] = set()
    for part in () if text.strip() == "none" else text.split(","):
        match = _NUMBERS.fullmatch(part.strip())
        if match is None:
            raise InputError(f"'{part.strip()}': expected {what} such as 1-10,13, or none")
        first, last = int(match[1]), int(match[2] or match[1])
        found |= {*range(first, last + 1)}
    return tuple(sorted(found))
