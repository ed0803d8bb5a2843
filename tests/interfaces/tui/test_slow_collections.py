"""What a slow pass of the collector went over is set aside until the job has ended."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from cellapp.interfaces.tui import app
from cellapp.interfaces.tui.app import SlowCollections


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(app, "gc", gc)  # other tests of screens have none
    before = list(gc.callbacks)
    yield
    gc.callbacks[:] = before


@pytest.mark.parametrize(("slow_s", "sets_aside"), [(-1.0, True), (60.0, False)])
def test_what_survives_a_slow_full_pass_is_set_aside(
    monkeypatch: pytest.MonkeyPatch, slow_s: float, sets_aside: bool
) -> None:
    monkeypatch.setattr(app, "_SLOW_S", slow_s)
    before = gc.get_freeze_count()
    SlowCollections().watch()
    gc.collect(1)
    assert gc.get_freeze_count() <= before
    gc.collect()
    assert (gc.get_freeze_count() > before) is sets_aside


def test_garbage_that_was_set_aside_is_collected_after_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "_SLOW_S", -1.0)
    passes = SlowCollections()
    passes.watch()
    cycle: list[object] = []
    cycle.append(cycle)
    gc.collect()
    del cycle
    before = gc.get_freeze_count()
    passes.look_again()
    assert gc.get_freeze_count() < before
