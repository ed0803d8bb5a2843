"""One self-contained HTML page of a fleet: arms with their condition, the worst first, then each arm over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cellapp.commands.fleet.charts import condition_charts, effect_chart, pair_chart, parameter_charts, trend_charts
from cellapp.commands.fleet.view import (
    arm_sentences,
    arm_tables,
    arms_table,
    certainty_sentence,
    pair_sentence,
    pair_table,
    runs_table,
)
from cellapp.commands.view.table import Table
from cellapp.estimation.monitoring.fleet.records import ArmCondition, ArmHistory, FleetResult, PairHistory
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.interfaces.page.captioned import CaptionedFigure
from cellapp.interfaces.page.chart_figure import chart_figure
from cellapp.interfaces.page.page_file import write_page_file
from cellapp.interfaces.page.plotly_script import plotly_base64, plotly_notice
from cellapp.interfaces.page.templates import template

_CLASSES: Mapping[ArmCondition, str] = {
    "beyond tolerance": "does-not-conform",
    "changed": "does-not-conform",
    "drifting": "cannot-say",
    "unchanged": "conforms",
    "not compared": "",
}
"""Classes of the style sheet, which the report has for verdicts."""


@dataclass(frozen=True)
class ArmSection:
    """One arm on the page; it is unfolded where something is wrong with it."""

    key: str
    name: str
    arm: ArmHistory
    css_class: str
    sentences: tuple[str, ...]
    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...]

    @property
    def title(self) -> str:
        """Name and condition."""
        return f"{self.name}: {self.arm.condition}"

    @property
    def message(self) -> str:
        """The first reason for the condition, or the number of runs."""
        return self.arm.reasons[0] if self.arm.reasons else self.sentences[0]

    @property
    def is_open(self) -> bool:
        """Whether a reader should see it at once."""
        return self.arm.condition in ("beyond tolerance", "changed", "drifting")

    @property
    def outdated(self) -> str:
        """Nothing on this page is out of date; runs that are say so."""
        return ""


@dataclass(frozen=True)
class PairSection:
    """The bases of two arms over time."""

    sentence: str
    figures: tuple[CaptionedFigure, ...]
    tables: tuple[Table, ...]


def write_fleet_page(result: FleetResult, path: Path, outputs: Outputs = NEW_ONLY) -> Path:
    """Write the page and return its path; it needs no other file and no network.

    Raises
    ------
    InputError
        If it cannot be written, or may not.
    """
    return write_page_file(path, fleet_page_text(result, datetime.now(UTC)), outputs)


def fleet_page_text(result: FleetResult, written: datetime) -> str:
    """The page as text."""
    sections = [arm_section(f"arm-{number}", name, arm) for number, (name, arm) in enumerate(result.arms.items(), 1)]
    return template("fleet.html").render(
        folders=result.folders,
        written=written.isoformat(timespec="seconds"),
        sections=sections,
        arms_table=arms_table(result),
        runs_table=runs_table(result, most=None),
        certainty=certainty_sentence(result),
        problems=[run.problem for run in result.runs if run.problem],
        notes=[*result.notes, *(f"{run.run}: {note}" for run in result.runs for note in run.notes)],
        pairs=[pair_section(f"pair-{number}", pair) for number, pair in enumerate(result.pairs, 1)],
        plotly=plotly_base64(),
        plotly_notice=plotly_notice(),
    )


def arm_section(key: str, name: str, arm: ArmHistory) -> ArmSection:
    """Sentences, charts and tables of one arm; ids of its figures begin with ``key``."""
    effects = effect_chart(arm)
    charts = [
        *trend_charts(arm),
        *([] if effects is None else [effects]),
        *parameter_charts(arm),
        *condition_charts(arm),
    ]
    return ArmSection(
        key=key,
        name=name,
        arm=arm,
        css_class=_CLASSES[arm.condition],
        sentences=tuple(sentence.removeprefix(f"{name}: ") for sentence in arm_sentences(name, arm)),
        figures=tuple(chart_figure(f"{key}-{number}", chart) for number, chart in enumerate(charts, 1)),
        tables=tuple(arm_tables(name, arm)),
    )


def pair_section(key: str, pair: PairHistory) -> PairSection:
    """What is known of the bases of two arms."""
    chart = pair_chart(pair)
    return PairSection(
        sentence=pair_sentence(pair),
        figures=() if chart is None else (chart_figure(key, chart),),
        tables=tuple(table for table in (pair_table(pair),) if table.rows),
    )
