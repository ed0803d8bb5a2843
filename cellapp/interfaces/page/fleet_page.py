"""One self-contained HTML page of a fleet: arms with their condition, the worst first, then each arm over time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from cellapp.commands.fleet.sections import arm_section, pair_section
from cellapp.commands.fleet.view import arms_table, certainty_sentence, runs_table
from cellapp.estimation.monitoring.fleet.records import ArmCondition, FleetResult
from cellapp.ground.outputs import NEW_ONLY, Outputs
from cellapp.interfaces.page.drawn import drawn_sections
from cellapp.interfaces.page.templates import plotly_base64, plotly_notice, template

_CLASSES: Mapping[ArmCondition, str] = {
    "beyond tolerance": "does-not-conform",
    "changed": "does-not-conform",
    "drifting": "cannot-say",
    "unchanged": "conforms",
    "not compared": "",
}
"""Classes of the style sheet; the report uses them for verdicts."""


def write_fleet_page(result: FleetResult, path: Path, outputs: Outputs = NEW_ONLY) -> Path:
    """Write the self-contained page and return its path; it needs no network.

    Raises
    ------
    InputError
        If it cannot be written, or may not.
    """
    outputs.write_text(path, fleet_page_text(result, datetime.now(UTC)))
    return path


def fleet_page_text(result: FleetResult, written: datetime) -> str:
    """Return the page as text."""
    arms = [arm_section(f"arm-{number}", name, arm) for number, (name, arm) in enumerate(result.arms.items(), 1)]
    return template("fleet.html").render(
        folders=result.folders,
        written=written.isoformat(timespec="seconds"),
        sections=drawn_sections(arms),
        css_classes=[_CLASSES[arm.condition] for arm in result.arms.values()],
        arms_table=arms_table(result),
        runs_table=runs_table(result, most=None),
        certainty=certainty_sentence(result),
        problems=[run.problem for run in result.runs if run.problem],
        notes=[*result.notes, *(f"{run.run}: {note}" for run in result.runs for note in run.notes)],
        pairs=drawn_sections(pair_section(f"pair-{number}", pair) for number, pair in enumerate(result.pairs, 1)),
        plotly=plotly_base64(),
        plotly_notice=plotly_notice(),
    )
