"""Calls that mostly wait, at the same time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

MOST_S = 240.0
"""The calls together; each wait within them has its own, shorter bound."""


def in_parallel(action: Callable[..., object], arguments: Iterable[tuple[Any, ...]]) -> None:
    """Call ``action`` with each tuple of arguments at the same time; raise the first error, with its arguments."""
    calls = list(arguments)
    with ThreadPoolExecutor(max(1, len(calls))) as pool:
        for values, future in [(values, pool.submit(action, *values)) for values in calls]:
            try:
                future.result(MOST_S)
            except BaseException as error:
                error.add_note(f"in {getattr(action, '__name__', action)}{values}")
                raise


def all_at_once(actions: Iterable[Callable[[], object]]) -> None:
    """Call all ``actions`` at the same time; raise the first error."""
    in_parallel(lambda action: action(), [(action,) for action in actions])
