"""Tables of the league for terminal and handbook."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.trials.league.series import SERIES
from cellapp.commands.trials.league.trial import CURVE_SERIES, LeagueLine, LeagueResult, bar_words
from cellapp.commands.view.table import Cell, Column, Number, Table, number_column

_MM = ".4f"


def league_tables(result: LeagueResult) -> list[Table]:
    """Errors, names and times, bars; and the learning curve where it was asked for."""
    title = "League of real robots: mean held-out position error [mm]"
    tables = [_error_table(title, result.lines), _name_table(result.lines), _bar_table(result)]
    if result.curve:
        title = f"Learning curve of series {CURVE_SERIES}, the same rows held out: mean position error [mm]"
        tables += [_error_table(title, result.curve), _name_table(result.curve)]
    return tables


def league_sentences(result: LeagueResult) -> list[str]:
    """How the tables came about."""
    names = dict.fromkeys(line.series for line in result.lines)
    titles = ", ".join(f"{name}: {SERIES[name].title}" for name in names)
    said = [
        f"{titles}; approach and step follow from the order of the rows. Errors are means over {result.seeds} draws of"
        " the rows learned from; worst: the worst draw over that mean; in 95 %: share of held-out coordinates within"
        " the interval that is stated for them; names: in how many draws discovery accepted the effect."
    ]
    said += [f"Published for {name}: {how}." for name in names if (how := SERIES[name].published_how)]
    said.append(f"{result.date}; {result.program}; {result.jobs} at a time, a thread each.")
    return said


def _error_table(title: str, lines: Sequence[LeagueLine]) -> Table:
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
        number_column("in 95 %", ".3f"),
        *([number_column("published", ".3f")] if published else []),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            line.series,
            line.learned,
            str(line.held_out) if line.group == "all" else f"{line.held_out} {line.group}",
            line.geometry_mm,
            *([line.network_mm] if networks else []),
            line.discovery_mm,
            line.worst_to_mean,
            line.within_95,
            *([line.published_mm] if published else []),
        )
        for line in lines
    ]
    return Table(title, columns, tuple(rows))


def _name_table(lines: Sequence[LeagueLine]) -> Table:
    """Names and times of the draws of every series and size."""
    columns = (
        Column("series"),
        number_column("rows", "d"),
        number_column("median", ".1f", "s"),
        number_column("longest", ".1f", "s"),
        Column("names"),
    )
    rows: dict[tuple[str, int], tuple[Cell, ...]] = {}
    for line in lines:  # the lines of one size differ in the rows held out only
        names = ", ".join(f"{name} {count}" for name, count in line.names.items()) or "none"
        rows[line.series, line.learned] = (line.series, line.learned, line.seconds_median, line.seconds_worst, names)
    return Table("Discovery: time of a draw, effects named and in how many draws", columns, tuple(rows.values()))


def _bar_table(result: LeagueResult) -> Table:
    columns = (Column("series"), Column("rows"), Column("bar"), Column("wanted"), Column("reached"), Column("met"))
    rows = tuple(
        (bar.series, str(bar.rows), bar.what, bar_words(bar), Number(bar.reached, 4), "yes" if bar.met else "no")
        for bar in result.bars
    )
    return Table("Bars", columns, rows)
