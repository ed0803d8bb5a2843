"""Times of results (ISO 8601 texts, in UTC) as people read them."""

from __future__ import annotations

_DAY, _MINUTE, _SECOND = (len(example) for example in ("2026-01-02", "2026-01-02T03:04", "2026-01-02T03:04:05"))


def day_of(time: str) -> str:
    """The date alone, such as "2026-01-02"."""
    return time[:_DAY]


def minute_of(time: str) -> str:
    """Date and time to the minute, such as "2026-01-02 03:04"."""
    return time[:_MINUTE].replace("T", " ")


def second_of(time: str) -> str:
    """Date and time to the second, such as "2026-01-02 03:04:05"."""
    return time[:_SECOND].replace("T", " ")
