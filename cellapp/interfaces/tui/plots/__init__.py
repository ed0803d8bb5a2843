"""Plots in the terminal: ``ChartPlot`` draws a chart of ``cellapp.commands.view.charts``.

Dots are set with numpy, without a plotting library, because a redraw runs in the event loop. Textual-plot took 22 ms
for two lines at 196 x 50 cells, plotext 14 ms at 38 x 10; here two lines of 1000 points take 4 ms at 200 x 60. The
frames and margins of those libraries left 3 to 6 of 10 rows for the data.
"""

from __future__ import annotations

from cellapp.interfaces.tui.plots.widget import ChartPlot

__all__ = ["ChartPlot"]
