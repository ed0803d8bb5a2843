"""Tables of the trial of earlier calibrations for terminal and handbook."""

from __future__ import annotations

from cellapp.commands.trials.signature import SignatureResult
from cellapp.commands.view.table import Table, table_of
from cellapp.ground.counting import counted

_MM = ".4f"
_ERRORS = (
    ("without", "alone_mm", _MM),
    ("with", "calibrated_mm", _MM),
    ("searched", "discovered_mm", _MM),
    ("exact", "exact_mm", _MM),
)


def signature_tables(result: SignatureResult) -> list[Table]:
    """Show means, bars and every draw."""
    return [
        table_of(
            "With and without the earlier calibration: mean held-out error [mm]",
            result.lines,
            ("cell", "cell"),
            ("stops", "stops", "d"),
            ("draws", "draws", "d"),
            *_ERRORS,
            ("worst", "worst_ratio", ".3f"),
            ("worse", "worse", "d"),
        ),
        table_of(
            "Every draw [mm]",
            result.draws,
            ("cell", "cell"),
            ("stops", "stops", "d"),
            ("draw", lambda draw: f"{draw.seed} {draw.arm}"),
            *_ERRORS,
        ),
        table_of(
            "Bars",
            result.bars,
            ("what", "what"),
            ("reached", "reached", _MM),
            ("at most", "most", _MM),
            ("met", lambda bar: "yes" if bar.met else "NO"),
        ),
    ]


def signature_sentences(result: SignatureResult) -> list[str]:
    """State the conditions of the tables, and every change reported as proven."""
    earlier = ", ".join(f"{name}: {stops}" for name, stops in result.earlier_stops.items())
    said = [
        f"Stops of the earlier calibration: {earlier}. Without: calibrate and discover on the new stops alone."
        " With: calibrate with the earlier run as prior; searched: then discover. Exact: the earlier values are kept,"
        " only base and tool are identified. Worst: the largest ratio of searched to without; worse: draws with a ratio"
        " above 1. Errors are means over stops that were not learned from."
    ]
    return said + [
        f"{draw.cell}, {counted(draw.stops, 'stop')}, seed {draw.seed}, arm {draw.arm}: {change}"
        for draw in result.draws
        for change in draw.changes
    ]
