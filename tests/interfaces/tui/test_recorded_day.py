"""The command that records a day: what it refuses, and that it keeps each moment as a text in its order."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.screens import SCREENS
from tests.interfaces.tui.pilot import PROFILES, SMALL, opened
from tests.interfaces.tui.recorded_day import Recorder, main


@pytest.mark.parametrize("arguments", [[], ["day", "1x1"]])
def test_what_cannot_be_recorded_is_refused_with_the_usage(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert "FOLDER [80x24 | 120x40 | 200x60 ...]" in capsys.readouterr().err
    assert not Path("day").exists()


async def test_every_screen_is_kept_in_the_order_of_the_day(tmp_path: Path) -> None:
    app = CellApp(PROFILES)
    async with app.run_test(size=SMALL) as pilot:
        await opened(pilot, app)
        day = Recorder(pilot, app, tmp_path)
        await day.keep_screens("empty")
    assert [path.name for path in sorted(tmp_path.glob("*.txt"))] == [
        f"{number:03}-empty-{entry.step}.txt" for number, entry in enumerate(SCREENS, start=1)
    ]
    assert "No run is open" in day.written[3].read_text("utf-8")
