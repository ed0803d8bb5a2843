"""Tables of the trial of earlier calibrations for terminal and handbook."""

from __future__ import annotations

from cellapp.commands.trials.signature import SignatureResult
from cellapp.commands.view.table import Column, Table, number_column

_MM = ".4f"
_WITHOUT = number_column("without", _MM)
_ERRORS = (
    _WITHOUT,
    number_column("with", _MM),
    number_column("searched", _MM),
    number_column("exact", _MM),
)


def signature_tables(result: SignatureResult) -> list[Table]:
    """Means, bars and every draw."""
    columns = (Column("cell"), number_column("stops", "d"), number_column("draws", "d"), *_ERRORS)
    lines = tuple(
        (
            line.cell,
            line.stops,
            line.draws,
            line.alone_mm,
            line.calibrated_mm,
            line.discovered_mm,
            line.exact_mm,
            line.worst_ratio,
            line.worse,
        )
        for line in result.lines
    )
    judged = (number_column("worst", ".3f"), number_column("worse", "d"))
    every = tuple(
        (
            draw.cell,
            draw.stops,
            f"{draw.seed} {draw.arm}",
            draw.alone_mm,
            draw.calibrated_mm,
            draw.discovered_mm,
            draw.exact_mm,
        )
        for draw in result.draws
    )
    bars = tuple((bar.what, bar.reached, bar.most, "yes" if bar.met else "NO") for bar in result.bars)
    return [
        Table("With and without the earlier calibration: mean held-out error [mm]", (*columns, *judged), lines),
        Table("Every draw [mm]", (Column("cell"), number_column("stops", "d"), Column("draw"), *_ERRORS), every),
        Table(
            "Bars",
            (Column("what"), number_column("reached", _MM), number_column("at most", _MM), Column("met")),
            bars,
        ),
    ]


def signature_sentences(result: SignatureResult) -> list[str]:
    """How the tables came about, and every change that was said to be proven."""
    earlier = ", ".join(f"{name}: {stops}" for name, stops in result.earlier_stops.items())
    said = [
        f"Earlier calibration from so many stops: {earlier}. Without: calibrate and discover on the new stops alone."
        " With: calibrate with the earlier run as prior; searched: then discover. Exact: the earlier values are kept,"
        " only base and tool are identified. Worst: the largest ratio of searched to without; worse: draws with a ratio"
        " above 1. Errors are means over stops that were not learned from."
    ]
    return said + [
        f"{draw.cell}, {draw.stops} stops, seed {draw.seed}, arm {draw.arm}: {change}"
        for draw in result.draws
        for change in draw.changes
    ]
