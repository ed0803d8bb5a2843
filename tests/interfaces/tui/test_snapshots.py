"""What every screen looks like with a finished run, at three sizes, as plain text; and that no number is cut.

The texts stand in ``snapshots/SCREEN-SIZE.txt``. Digits and the dots of plots are not compared: other tests check
numbers, and the last place depends on the processor. Colours are not compared, so that another release of Textual
changes nothing here.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, TabbedContent, TabPane

from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.screens import SCREENS
from tests.approved import differences
from tests.handbook.screen_pictures import settle
from tests.interfaces.tui.pilot import PROFILES, SIZES, WAIT_S, running, shown_text, shows, until

SNAPSHOTS = Path(__file__).parent / "snapshots"
_PLOT = re.compile("[\u2800-\u28ff]")
_PART_OF_BLOCK = re.compile("[▏▎▍▌▋▊▉]")
_SAME = 4
"""Looks at a screen, each after a pause, that must find the same."""
_NUMBER = re.compile(r"\W*\d[\d.,/]*( ?[a-zA-Z%°]{1,4})?")
"""A cell that is a number, perhaps with a unit; a longer text is repeated in full below its table."""
_SPAN = re.compile(r"\d+(\.\d+)? (s|min|h)\b *")


def words_of(text: str) -> str:
    """A screen's text without what may differ: digits, durations, dots of plots."""
    text = _SPAN.sub("0 s ", text)
    for pattern, same in ((re.compile(r"\d"), "0"), (_PLOT, "⠿"), (_PART_OF_BLOCK, "█")):
        text = pattern.sub(same, text)
    return "\n".join(line.rstrip() for line in text.splitlines())


@asynccontextmanager
async def day(run: Path, size: tuple[int, int]) -> AsyncIterator[tuple[Pilot[None], CellApp]]:
    """The application with a copy of a run."""
    folder = Path("logs") / "day"
    shutil.copytree(run, folder)
    shutil.copytree(PROFILES, "profiles")
    async with running(Path("profiles"), size=size) as (pilot, app):
        app.open_run(folder)
        await until(pilot, lambda: app.workspace.results is not None, "the run")
        await settle(pilot)
        yield pilot, app


def size_name(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


@pytest.mark.parametrize(
    "size", [SIZES[0], *(pytest.param(size, marks=pytest.mark.slow) for size in SIZES[1:])], ids=size_name
)
async def test_every_screen_looks_as_it_did_and_cuts_no_number(size: tuple[int, int], finished_run: Path) -> None:
    changed, cut = list[str](), list[str]()
    async with day(finished_run, size) as (pilot, app):
        for entry in SCREENS:
            await pilot.press(entry.key)
            await until(pilot, lambda step=entry.step: step == app.day_screen.STEP, entry.step)  # type: ignore[misc]
            await settle(pilot)
            name = SNAPSHOTS / f"{entry.step}-{size_name(size)}.txt"
            changed += differences(name, await final_text(pilot, app), words_of)
            for tab in app.screen.query(TabPane).results():
                app.screen.query_one(TabbedContent).active = tab.id or ""
                await final_text(pilot, app)
                cut += [f"{entry.step}, {tab.id}: {text}" for text in numbers_cut(app)]
            cut += [f"{entry.step}: {text}" for text in numbers_cut(app)]
    assert not changed, "\n".join([*changed, "if this was wanted, write them anew as tests/approved.py says"])
    assert not cut, "\n".join(cut)


async def final_text(pilot: Pilot[None], app: CellApp) -> str:
    """The screen once no word changes any more: a table is as wide as its headings until it is idle."""
    seen: list[str] = []

    def same_twice() -> bool:
        seen.append(words_of(shown_text(app)))
        reads = "reading the folder of runs ..." in seen[-1]  # in a thread, which on a busy computer may rest
        return not reads and len(seen) > _SAME and len(set(seen[-_SAME:])) == 1

    await until(pilot, same_twice, "a screen that rests")
    return shown_text(app)


def numbers_cut(app: CellApp) -> list[str]:
    """Numbers that the screen shows without their end; a long path in the first line may be cut."""
    lines = shown_text(app).splitlines()[1:]
    return [line for line in lines if re.search(r"\d…", line)] + list(cells_cut(app))


def cells_cut(app: CellApp) -> Iterator[str]:
    """Numbers that the right edge of their table or of the screen cuts."""
    for table in app.screen.query(DataTable).results():
        if not table.is_on_screen or not table.region.width:
            continue
        right = min(table.scrollable_content_region.right, app.size.width) - table.scrollable_content_region.x
        begin = -table.scroll_offset.x
        for place, column in enumerate(table.ordered_columns):
            end = begin + column.get_render_width(table)
            for row in range(table.row_count):
                text = str(table.get_row_at(row)[place])
                wider = len(text) > column.get_render_width(table) - 2 * table.cell_padding
                crossed = begin < right < begin + table.cell_padding + len(text)
                if _NUMBER.fullmatch(text) and (wider or crossed):
                    yield f"{table.id or table.__class__.__name__}, {column.label}: {text}"
            begin = end


async def test_a_tiny_terminal_gets_a_sentence_and_stop() -> None:
    async with running(size=(40, 10)) as (pilot, app):
        for entry in SCREENS:
            await pilot.press(entry.key)
            await pilot.pause()
            lines = shown_text(app).splitlines()
            assert lines[0].endswith("STOP  Esc")
            await shows(pilot, "Make the terminal larger, at least 80x24")
        await pilot.resize_terminal(80, 24)
        await until(pilot, lambda: "1 Cell" in shown_text(app), "the screen after the terminal was made larger")
        assert "larger" not in shown_text(app)


def test_no_terminal_is_said_in_a_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cellapp"]
    ended = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(PROFILES.parent)}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=WAIT_S,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert "needs a terminal" in ended.stderr
    assert "cellapp run PROFILE" in ended.stderr
    assert "Traceback" not in ended.stderr
