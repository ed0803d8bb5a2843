"""Numbers with the noun that they count."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """``1 stop``, ``3 stops``; ``many`` is the plural where it is not ``one`` with an s, as "stops are"."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"
