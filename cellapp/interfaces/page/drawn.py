"""Sections as the page draws them: charts as figures with anchors, and parts grouped by kind."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Parts, Section
from cellapp.commands.view.scene import CellScene
from cellapp.commands.view.table import Table
from cellapp.interfaces.page.cell_figures import scene_figure
from cellapp.interfaces.page.figure import Figure, chart_figure

_HALF, _GAP, _SENTENCE = 60, 2, 30
"""Characters: of a table in half of a screen, between two columns, and of a line of a sentence in a cell."""


@dataclass(frozen=True)
class DrawnParts:
    """Parts in the order of the page; each table comes with whether it needs the whole width."""

    sentences: tuple[str, ...]
    facts: tuple[Facts, ...]
    figures: tuple[Figure, ...]
    tables: tuple[tuple[Table, bool], ...]
    sections: tuple[DrawnSection, ...]


@dataclass(frozen=True)
class DrawnSection:
    """A section and its content."""

    told: Section
    parts: DrawnParts


def drawn_sections(sections: Iterable[Section], key: str = "") -> tuple[DrawnSection, ...]:
    """Return sections with their content; those without an anchor number their figures below ``key``."""
    return tuple(
        DrawnSection(one, drawn_parts(one.parts, one.key or f"{key}-{place}")) for place, one in enumerate(sections, 1)
    )


def drawn_parts(parts: Parts, key: str) -> DrawnParts:
    """Group parts by kind; anchors of figures are ``key`` and a number. Charts without values are omitted."""
    charts = [one for one in parts if isinstance(one, CellScene) or (isinstance(one, Chart) and not one.is_empty)]
    return DrawnParts(
        sentences=tuple(one for one in parts if isinstance(one, str) and one),
        facts=tuple(one for one in parts if isinstance(one, Facts)),
        figures=tuple(_figure(f"{key}-{place}", chart) for place, chart in enumerate(charts, start=1)),
        tables=tuple((one, _is_wide(one)) for one in parts if isinstance(one, Table)),
        sections=drawn_sections((one for one in parts if isinstance(one, Section)), f"{key}-part"),
    )


def _is_wide(table: Table) -> bool:
    """Return whether the cells of a table need more than half of a screen."""
    rows = [table.headings, *table.text_rows()]
    longest = [max(max(map(len, word.split()), default=0) for word in column) for column in zip(*rows, strict=True)]
    texts = [min(max(map(len, column)), _SENTENCE) for column in zip(*table.text_rows(), strict=True)]
    return sum(map(max, longest, texts or longest)) + _GAP * len(longest) > _HALF


def _figure(key: str, chart: Chart | CellScene) -> Figure:
    return scene_figure(key, chart) if isinstance(chart, CellScene) else chart_figure(key, chart)
