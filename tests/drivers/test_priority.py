"""Priorities: where they are not permitted nothing changes, and what measures times gives its own back."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from drivers import priority
from tests.waiting import within

pytestmark = pytest.mark.fast


def refused(*_: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_what_is_not_permitted_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "setpriority", refused, raising=False)
    monkeypatch.setattr(os, "sched_setscheduler", refused, raising=False)
    priority.run_first(-10)
    for inherited in (False, True):
        with priority.in_real_time(inherited=inherited) as permitted:
            assert not permitted


@pytest.mark.skipif(sys.platform != "linux", reason="schedulers are those of Linux")
def test_only_the_thread_that_measures_runs_in_real_time_and_only_meanwhile() -> None:
    before = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK  # that flag stays with who measured before
    policies: list[int] = []
    with priority.in_real_time() as permitted:
        if not permitted:
            pytest.skip("this user may not run in real time")
        assert os.sched_getscheduler(0) & os.SCHED_RR
        other = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        other.start()
        within(other.join, "the end of the other thread")
        text = "import os; print(os.sched_getscheduler(0))"
        policies.append(int(subprocess.check_output([sys.executable, "-c", text])))
    assert policies == [before, before]
    assert not os.sched_getscheduler(0) & os.SCHED_RR
