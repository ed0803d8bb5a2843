"""Judging without processes of its own, which take longer to start than a small run to judge."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

import pytest

from cellapp.trials import judge

Given = ParamSpec("Given")
Outcome = TypeVar("Outcome")


class InThisProcess(Executor):
    """Calls what is submitted at once, here; takes the arguments of a ``ProcessPoolExecutor``."""

    def __init__(self, *_: Any, **__: Any) -> None:
        super().__init__()

    def submit(
        self, function: Callable[Given, Outcome], /, *args: Given.args, **kwargs: Given.kwargs
    ) -> Future[Outcome]:
        future = Future[Outcome]()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:  # noqa: BLE001 - as a pool: what failed is raised where the result is asked for
            future.set_exception(error)
        return future


@pytest.fixture
def judged_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """``judge_trials`` works in this process."""
    monkeypatch.setattr(judge, "ProcessPoolExecutor", InThisProcess)
