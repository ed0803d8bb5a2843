"""The strip below the header of every screen: age of the data of arms, tracker and job, and the progress of a halt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content
from textual.widgets import Static

from cellapp.ground.progress import CellLive
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.live_words import Banner, Look, Part, banner_of, strip_of

_STYLES: Mapping[Look, str] = {"fresh": "$text-success", "late": "bold $text-warning", "lost": "bold white on $error"}


class LiveStrip(Vertical):
    """Ages in one line while a cell is open; above them, in red, a stop or an arm that counts as moving.

    The application asks it to look ten times a second, so that neither a job that hangs nor a missing event leaves it
    out of date.
    """

    DEFAULT_CSS = """
    LiveStrip { height: auto; }
    LiveStrip .banner { height: auto; max-height: 3; padding: 0 1; background: $warning-muted; display: none; }
    LiveStrip .banner.alarm { background: $error; color: white; text-style: bold; }
    LiveStrip .ages { height: 1; padding: 0 1; background: $surface; text-wrap: nowrap; text-overflow: ellipsis; }
    LiveStrip .ages { display: none; }
    LiveStrip .shown { display: block; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._drawn: tuple[Banner | None, tuple[Part, ...]] = (None, ())

    def compose(self) -> ComposeResult:
        yield Static("", classes="banner", markup=False)
        yield Static("", classes="ages", markup=False)

    def look(self) -> None:
        """Query the current state, and draw what has changed."""
        app = cast(Host, self.app)
        self.show(app.live(), app.workspace.unseen)

    def show(self, live: CellLive | None, unseen: Mapping[str, str]) -> None:
        """Draw the state, and the arms that the run counts as moving, arm -> why."""
        banner, parts = banner_of(live, unseen), () if live is None else tuple(strip_of(live))
        if (banner, parts) == self._drawn:
            return
        if banner != self._drawn[0]:
            box = self.query_one(".banner", Static)
            box.set_classes("banner" if banner is None else f"banner shown{' alarm' if banner.alarm else ''}")
            box.update("" if banner is None else "\n".join([banner.words, *banner.causes[:2]]))
        ages = self.query_one(".ages", Static)
        ages.set_class(bool(parts), "shown")
        ages.update(Content("   ").join(Content.styled(part.text, _STYLES[part.look]) for part in parts))
        self._drawn = (banner, parts)
