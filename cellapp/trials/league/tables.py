"""Tables of the league for terminal and README."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.reporting.table import Cell, Column, Number, Table, number_column
from cellapp.trials.league.series import SERIES, Group
from cellapp.trials.league.trial import CURVE_SERIES, LeagueLine, LeagueResult, bar_words

_MM = ".4f"
_GROUPS: Mapping[Group, str] = {"all": "all", "grid": "other grid poses", "random": "random poses"}


def league_tables(result: LeagueResult) -> list[Table]:
    """The league, the bars, and the learning curve where it was asked for."""
    tables = [
        _league_table("League of real robots: mean held-out position error [mm]", result.lines),
        _bar_table(result),
    ]
    if result.curve:
        title = f"Learning curve of series {CURVE_SERIES}, the same rows held out: mean position error [mm]"
        tables.append(_league_table(title, result.curve))
    return tables


def league_sentences(result: LeagueResult) -> list[str]:
    """How the tables came about."""
    titles = ", ".join(f"{name}: {SERIES[name].title}" for name in dict.fromkeys(line.series for line in result.lines))
    return [
        f"{titles}. Mean over {result.seeds} draws of the rows learned from; worst: the worst draw over that mean;"
        " within 95 %: share of held-out coordinates within the interval stated for them; names: in how many draws"
        " discovery accepted the effect. Approach and step follow from the order of the rows.",
        f"{result.date}; {result.program}; {result.jobs} at a time, a thread each.",
    ]


def _league_table(title: str, lines: Sequence[LeagueLine]) -> Table:
    networks = any(line.network_mm is not None for line in lines)
    published = any(line.published_mm is not None for line in lines)
    columns = (
        Column("series"),
        number_column("rows", "d"),
        Column("held out"),
        number_column("geometry", _MM),
        *([number_column("network", _MM)] if networks else []),
        number_column("discovery", _MM),
        number_column("worst", ".2f"),
        number_column("within 95 %", ".1f", "%"),
        *([number_column("published", ".3f")] if published else []),
        number_column("median", ".1f", "s"),
        number_column("longest", ".1f", "s"),
        Column("names"),
    )
    rows: list[tuple[Cell, ...]] = []
    for line in lines:
        names = ", ".join(f"{name} {count}" for name, count in line.names.items())
        rows.append(
            (
                line.series,
                line.learned,
                f"{line.held_out} {_GROUPS[line.group]}" if line.group != "all" else str(line.held_out),
                line.geometry_mm,
                *([line.network_mm] if networks else []),
                line.discovery_mm,
                line.worst_to_mean,
                100.0 * line.within_95,
                *([line.published_mm] if published else []),
                # names and times are those of the draw, not of a part of its held-out rows
                *(
                    (line.seconds_median, line.seconds_worst, names or "none")
                    if line.group == "all"
                    else (None, None, "")
                ),
            )
        )
    return Table(title, columns, tuple(rows))


def _bar_table(result: LeagueResult) -> Table:
    columns = (Column("series"), Column("rows"), Column("bar"), Column("wanted"), Column("reached"), Column("met"))
    rows = tuple(
        (bar.series, str(bar.rows), bar.what, bar_words(bar), Number(bar.reached, 4), "yes" if bar.met else "no")
        for bar in result.bars
    )
    return Table("Bars", columns, rows)
