"""Tests of the terminal application run in a folder of their own, wait for no animation and paint only what they look
at."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from textual._animator import Animator
from textual._compositor import Compositor
from textual.css.model import RuleSet
from textual.css.stylesheet import Stylesheet
from textual.screen import Screen

from tests.interfaces.tui.idle import wait_for_idle, wait_for_screen
from tests.waiting import WAIT_S

_painted = Compositor.render_update
_parsed = Stylesheet._parse_rules
_RULES: dict[tuple[object, ...], list[RuleSet]] = {}
"""What was parsed of styles, for all applications of a process: the same words give the same rules."""


@pytest.fixture
def painted() -> None:
    """For tests of how fast the application is: it paints as in a terminal."""


@pytest.fixture(autouse=True)
def _surroundings(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.pilot.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.app.wait_for_idle", wait_for_idle)
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "none")
    monkeypatch.setattr(Animator, "wait_until_complete", _animations_end)  # a key waits for them, without a bound
    monkeypatch.setattr(Stylesheet, "_parse_rules", _rules)
    # sets aside for good what is there: right for one application a process, of hundreds it keeps gigabytes
    monkeypatch.setattr("cellapp.interfaces.tui.app.gc", SimpleNamespace(collect=int, freeze=int))
    monkeypatch.chdir(tmp_path)  # runs go to logs in the working directory
    # beside emulated devices, whose clients stop an arm after 0.3 s of silence, it looks as rarely as Textual does
    if "painted" not in request.fixturenames and request.node.get_closest_marker("waits") is None:
        monkeypatch.setattr("textual.pilot.Pilot._wait_for_screen", wait_for_screen)
        monkeypatch.setattr(Compositor, "render_update", _update)


async def _animations_end(animator: Animator) -> None:
    try:
        async with asyncio.timeout(WAIT_S):
            await animator._complete_event.wait()
    except TimeoutError:
        pytest.fail(f"not within {WAIT_S:g} s: the end of {[*animator._animations, *animator._scheduled]}")


def _rules(sheet: Stylesheet, css: str, *where: Any, **origin: Any) -> list[RuleSet]:
    key = (css, where, *origin.items(), *sheet._variables.items())
    if key not in _RULES:
        _RULES[key] = _parsed(sheet, css, *where, **origin)
    return _RULES[key]


def _update(compositor: Compositor, full: bool = False, screen_stack: list[Screen] | None = None, **how: Any) -> Any:
    """Paint only on request, as for a picture: there is no terminal that would show it, and a third of all time goes
    there. ``pilot.until`` and ``shown_text`` paint the whole screen."""
    if full:
        return _painted(compositor, full, screen_stack, **how)
    compositor._dirty_regions.clear()
    return None
