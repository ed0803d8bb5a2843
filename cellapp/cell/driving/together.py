"""Call all arms of a cell concurrently: in real time, one slow arm does not delay the others."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeVar

from drivers.arms.protocol import ArmError

Together = Callable[[Sequence[Callable[[], None]]], None]
"""Function that calls functions, concurrently if time is real."""
T = TypeVar("T")


def in_threads(calls: Sequence[Callable[[], None]]) -> None:
    """Call every function in a thread of its own and return at once: one that hangs does not delay the others."""
    without_thread = []
    for call in calls:
        try:
            threading.Thread(target=call, name="all arms", daemon=True).start()
        except RuntimeError:  # the system cannot start another thread
            without_thread.append(call)
    one_by_one(without_thread)


def one_by_one(calls: Sequence[Callable[[], None]]) -> None:
    """Call the functions one after the other: simulated time does not pass in the meantime."""
    for call in calls:
        call()


def answers_of_all(
    together: Together, calls: Mapping[str, Callable[[], T]]
) -> tuple[dict[str, T], dict[str, ArmError]]:
    """Call a function for each arm and wait for all; return answers and errors by arm.

    This terminates: every call of a driver has a timeout.
    """
    answers: dict[str, T] = {}
    errors = {name: ArmError(f"arm {name}: its driver gave no answer") for name in calls}
    answered = {name: threading.Event() for name in calls}

    def ask(name: str) -> None:
        try:
            answers[name] = calls[name]()
            del errors[name]
        except ArmError as error:
            errors[name] = error
        finally:
            answered[name].set()

    together([partial(ask, name) for name in calls])
    for one in answered.values():
        one.wait()
    return answers, errors
