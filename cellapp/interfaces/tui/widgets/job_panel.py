"""The live job on every screen: its parts with bars, rate and remaining time, each arm's activity, the newest lines."""

from __future__ import annotations

from itertools import islice
from typing import cast

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content
from textual.widgets import Static

from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.job_record import JobRecord, LogRow
from cellapp.interfaces.tui.widgets.arm_panel import activity_words
from cellapp.interfaces.tui.widgets.progress_bars import ProgressBars, parts_of

_TALL, _HUGE = 34, 50
"""Numbers of terminal lines from which more of the job is shown."""
_LEVEL_STYLES = {"warning": "$text-warning", "error": "bold $text-error"}


class JobPanel(Vertical):
    """Panel of the live job, hidden while no job runs."""

    DEFAULT_CSS = """
    JobPanel { height: auto; background: $panel; padding: 0 1; display: none; }
    JobPanel.shown { display: block; }
    JobPanel .arms { height: auto; max-height: 2; }
    JobPanel .newest { height: auto; text-wrap: nowrap; text-overflow: ellipsis; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._drawn: tuple[object, ...] = ()
        self.tooltip = "The job: its parts, steps a minute, the time that is left; each arm; its newest lines."

    def compose(self) -> ComposeResult:
        yield ProgressBars()
        yield Static("", classes="arms", markup=False)
        yield Static("", classes="newest", markup=False)

    def on_mount(self) -> None:
        """Draw a job that is already running."""
        self.show(cast(Host, self.app).record)

    def show(self, record: JobRecord) -> None:
        """Draw the current state of the job."""
        self.set_class(record.state is not None, "shown")
        if record.state is None or not self.children:  # its own widgets are mounted a moment later
            return
        height = self.app.size.height
        bars = self.query_one(ProgressBars)
        bars.compact, bars.parts = height < _HUGE, parts_of(record)
        bars.styles.height = bars.lines  # set explicitly: its container does not ask again
        arms = "   ".join(
            f"{name} {activity_words(arm)}" for name, arm in record.arms.items() if arm.activity != "unknown"
        )
        most = 1 if height < _TALL else 3 if height < _HUGE else 5
        told = (row for row in reversed(record.log) if row.level != "debug")
        drawn = (arms, *islice(told, most))
        if drawn == self._drawn:
            return
        self._drawn = drawn
        line = self.query_one(".arms", Static)
        line.display = bool(arms)
        line.update(arms)
        newest = [row for row in reversed(drawn) if isinstance(row, LogRow)]
        lines = [Content.styled(f"{row.at:%H:%M:%S} {row.text}", _LEVEL_STYLES.get(row.level, "")) for row in newest]
        self.query_one(".newest", Static).update(Content("\n").join(lines))
