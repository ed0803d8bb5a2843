"""Readings of one's own in the terminal application: from the first start to a run that can be calibrated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static

from cellapp.cell.run import RunFile
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.dialogs.first_run import Welcome
from cellapp.interfaces.tui.dialogs.verb_question import VerbQuestion
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from tests.arms import UR5
from tests.interfaces.tui.pilot import until

SIZE = (120, 40)


@pytest.fixture
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellApp:
    monkeypatch.chdir(tmp_path)
    q = np.random.default_rng(2).uniform(-2.5, 2.5, (40, 6))
    p_M = smr_positions(nominal_geometry(UR5, np.array([0.0, 0.02, 0.08])), q)
    rows = [" ".join(f"{v:.6f}" for v in (*np.degrees(a), *b)) for a, b in zip(q, p_M, strict=True)]
    Path("mine.txt").write_text("\n".join(["j1 j2 j3 j4 j5 j6 x y z", *rows]))
    return CellApp(Path("profiles"))


async def dialog(pilot: Pilot[None], app: CellApp, **typed: str) -> None:
    """Fill in the dialog from the first start on, and send it."""
    await until(pilot, lambda: isinstance(app.screen, Welcome), "the question")
    await pilot.press("r")
    await until(pilot, lambda: isinstance(app.screen, VerbQuestion), "the dialog")
    for name, text in typed.items():
        app.screen.query_one(f"#{name}", Input).value = text
    await until(pilot, lambda: isinstance(app.focused, Input), "the first field")
    await pilot.press("enter")


async def test_from_a_table_to_an_open_run(app: CellApp) -> None:
    async with app.run_test(size=SIZE) as pilot:
        await dialog(pilot, app, readings="mine.txt", arm="ur5")
        await until(pilot, lambda: app.workspace.folder == Path("logs/mine"), "the run")
        assert app.workspace.next_step == "calibrate"
    with RunFile.open(Path("logs/mine")) as run:
        assert len(run.readings("robot")) == 40
    assert Path("profiles/mine.yaml").is_file()


async def test_wrong_words_are_refused_in_the_dialog(app: CellApp) -> None:
    async with app.run_test(size=SIZE) as pilot:
        await dialog(pilot, app, readings="mine.txt", angles="turns")
        await until(pilot, lambda: "rad" in str(app.screen.query_one("#why", Static).content), "the sentence")
        assert isinstance(app.screen, VerbQuestion)


async def test_an_arm_that_is_not_named_is_a_message(app: CellApp) -> None:
    async with app.run_test(size=SIZE) as pilot:
        await dialog(pilot, app, readings="mine.txt")
        await until(pilot, lambda: "which arm?" in app.message, "the message")
        assert "ur5 (0.0 mm)" in app.message
    assert not Path("logs/mine").exists()
