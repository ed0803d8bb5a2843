"""Values that a test knows to be there: for the checker of types, and a failure of the test where they are not."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def sure(value: T | None) -> T:
    """The value, which is not None."""
    assert value is not None
    return value
