"""The history of each arm over many runs, over the screen Runs."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from textual import work as in_thread
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Static, TabbedContent, TabPane

from cellapp.commands.fleet.sections import arm_section, pair_section
from cellapp.commands.fleet.view import arm_sentences, fleet_sentences, fleet_tables
from cellapp.commands.view.charts import Chart
from cellapp.estimation.monitoring.fleet.records import FleetResult
from cellapp.ground.errors import CellappError
from cellapp.ground.outputs import RENEWED
from cellapp.interfaces.tui.dialogs.question import Question
from cellapp.interfaces.tui.dialogs.save_as import SaveAs
from cellapp.interfaces.tui.widgets.charts_view import ChartsView
from cellapp.interfaces.tui.widgets.tables import TablesView, show_next_tab

PAGE = "fleet.html"


class FleetHistory(Question[None]):
    """Sentences and tables of a fleet, and charts of one arm at a time: to scroll, to copy, to save.

    Parameters
    ----------
    result : FleetResult
    folder : Path
        Proposed folder of the page.
    """

    DEFAULT_CSS = """
    FleetHistory #fleet-tables { overflow-x: auto; }
    FleetHistory .table, FleetHistory .table DataTable { width: auto; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("t", "next_tab", "Next tab"),
        Binding("a", "other_arm", "Other arm"),
        Binding("o", "page", "Page"),
    ]

    def __init__(self, result: FleetResult, folder: Path) -> None:
        super().__init__()
        self._result, self._folder = result, folder
        self._arm = 0

    def body(self) -> ComposeResult:
        yield Static("Arms over their runs", classes="title", markup=False)
        with TabbedContent():
            with TabPane("Arms", id="arms-pane"):
                yield TablesView("No arm was found in these runs.", id="fleet-tables")
            with TabPane("Trends", id="trends-pane"):
                yield ChartsView("No arm was found in these runs.", id="fleet-charts")
        keys = f"t: other tab; a: charts of the next arm; o: page; arrows scroll; {self.closing_key} closes."
        yield Static(keys, classes="muted", markup=False)

    async def on_mount(self) -> None:
        """Draw the history, and focus it so that keys scroll it."""
        tables = self.query_one("#fleet-tables", TablesView)
        tables.show(fleet_tables(self._result), fleet_sentences(self._result))
        tables.focus()
        await self._draw_charts()

    def action_next_tab(self) -> None:
        """Show the other tab."""
        tabs = self.query_one(TabbedContent)
        show_next_tab(tabs)
        shown = "#fleet-tables" if tabs.active == "arms-pane" else "#fleet-charts"
        self.call_after_refresh(self.query_one(shown).focus)

    async def action_other_arm(self) -> None:
        """Show the charts of the next arm."""
        self._arm += 1
        self.query_one(TabbedContent).active = "trends-pane"
        await self._draw_charts()

    def action_page(self) -> None:
        """Ask for a file, and write the page."""

        def write(path: Path | None) -> None:
            if path is not None:
                self._write(path)

        self.app.push_screen(SaveAs("the page", None, self._folder / PAGE), write)

    @in_thread(thread=True)
    def _write(self, path: Path) -> None:
        from cellapp.interfaces.page.fleet_page import write_fleet_page

        try:
            said = f"page: {write_fleet_page(self._result, path, RENEWED)}"
        except CellappError as error:
            said = str(error)
        self.app.call_from_thread(self.notify, said)

    async def _draw_charts(self) -> None:
        names = list(self._result.arms)
        if not names:
            return
        name = names[self._arm % len(names)]
        arm = self._result.arms[name]
        pairs = [pair_section("", pair) for pair in self._result.pairs if name in pair.arms]
        parts = [part for section in (arm_section("", name, arm), *pairs) for part in section.parts]
        charts = [part for part in parts if isinstance(part, Chart)]
        await self.query_one("#fleet-charts", ChartsView).show(charts, (), arm_sentences(name, arm))
