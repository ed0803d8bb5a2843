"""Tables of the trial of links."""

from __future__ import annotations

from cellapp.commands.view.table import Cell, Column, Table, number_column
from tests.trials.link_results import LinksResult, Times


def link_tables(result: LinksResult) -> list[Table]:
    """Times of emulated arms under the real client: without faults, then the reaction of the cell to each fault."""
    rows = (
        _times("connect", result.connect_s),
        _times("ask for the state", result.state_s),
        _times("motion, beyond its ideal time", result.move_overhead_s),
    )
    numbers = (number_column(title, ".3f") for title in ("median", "95 %", "max"))
    quiet = Table("Times without a fault [s]", (Column("what"), *numbers, number_column("n", "d")), rows)
    longest = [
        (
            fault,
            None if times.recovered_s is None else times.recovered_s.n,
            *(
                None if one is None else one.max
                for one in (
                    times.detected_s,
                    times.at_rest_s,
                    times.commanded_s,
                    times.beyond_braking_s,
                    times.recovered_s,
                )
            ),
            "none to stop" if times.commanded_s is None else "kept" if times.kept else "MISSED",
        )
        for fault, times in result.by_fault.items()
    ]
    columns = (
        Column("fault"),
        number_column("n", "d"),
        number_column("doubt", ".3f"),
        number_column("arm at rest", ".3f"),
        number_column("others: stop", ".3f"),
        number_column("others: rest", ".3f"),
        number_column("ready", ".3f"),
        Column("bars"),
    )
    title = (
        "Longest times after a fault [s]; bars of the other arms, from the first doubt:"
        f" {result.commanded_within_s:g} s to the stop received,"
        f" {result.rest_beyond_braking_s:g} s to rest beyond the ideal braking time"
    )
    return [quiet, Table(title, columns, tuple(longest))]


def _times(what: str, times: Times | None) -> tuple[Cell, ...]:
    return (what, None, None, None, 0) if times is None else (what, times.median, times.p95, times.max, times.n)
