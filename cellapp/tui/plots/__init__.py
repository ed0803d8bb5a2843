"""Plots in the terminal: ``ChartPlot`` draws a chart of ``cellapp.reporting.charts``.

Braille dots are set with numpy arrays: of the libraries tried, textual-plot took 22 ms and plotext more for one redraw
at 190 x 50 cells, in the event loop, which a live plot at every stop does not have; and a frame and margins left 3 of
10 rows for the data in a narrow plot.
"""

from __future__ import annotations

from cellapp.tui.plots.widget import ChartPlot

__all__ = ["ChartPlot"]
