"""Tables of the league for terminal and handbook."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.trials.league.series import SERIES
from cellapp.commands.trials.league.trial import CURVE_SERIES, LeagueLine, LeagueResult, bar_words
from cellapp.commands.view.table import Number, Table, table_of
from cellapp.ground.counting import counted

_MM = ".4f"


def league_tables(result: LeagueResult) -> list[Table]:
    """Show errors, effects and times, bars; and the learning curve if requested."""
    title = "League of real robots: mean held-out position error [mm]"
    turned = [line for line in result.lines if line.turned is not None]
    tables = [_error_table(title, result.lines), *([_turn_table(turned)] if turned else [])]
    tables += [_name_table(result.lines), _bar_table(result)]
    if result.curve:
        title = f"Learning curve of series {CURVE_SERIES}, the same rows held out: mean position error [mm]"
        tables += [_error_table(title, result.curve), _name_table(result.curve)]
    return tables


def league_sentences(result: LeagueResult) -> list[str]:
    """State the conditions of the tables."""
    names = dict.fromkeys(line.series for line in result.lines)
    titles = ", ".join(f"{name}: {SERIES[name].title}" for name in names)
    said = [
        f"{titles}; approach and step follow from the order of the rows. Errors are means over"
        f" {counted(result.seeds, 'draw')} of"
        " the rows learned from; worst: the worst draw over that mean; in 95 %: share of held-out coordinates within"
        " the interval that is stated for them; names: in how many draws discovery accepted the effect."
    ]
    said += [f"Published for {name}: {how}." for name in names if (how := SERIES[name].published_how)]
    said.append(f"{result.date}; {result.program}; {result.jobs} at a time, a thread each.")
    return said


def _error_table(title: str, lines: Sequence[LeagueLine]) -> Table:
    networks = any(line.network_mm is not None for line in lines)
    published = any(line.published_mm is not None for line in lines)
    return table_of(
        title,
        lines,
        ("series", "series"),
        ("rows", "learned", "d"),
        ("held out", lambda line: f"{line.held_out}{'' if line.group == 'all' else f' {line.group}'}"),
        ("geometry", "geometry_mm", _MM),
        *([("network", "network_mm", _MM)] if networks else []),
        ("discovery", "discovery_mm", _MM),
        ("worst", "worst_to_mean", ".2f"),
        ("in 95 %", "within_95", ".3f"),
        *([("published", "published_mm", ".3f")] if published else []),
    )


def _turn_table(lines: Sequence[LeagueLine]) -> Table:
    """Show errors of orientations."""

    def of(line: LeagueLine, name: str) -> float | None:
        return None if line.turned is None else getattr(line.turned, name)

    return table_of(
        "Mean held-out orientation error [mrad]",
        lines,
        ("series", "series"),
        ("rows", "learned", "d"),
        ("geometry", lambda line: of(line, "geometry_mrad"), _MM),
        ("discovery", lambda line: of(line, "discovery_mrad"), _MM),
        ("in 95 %", lambda line: of(line, "within_95"), ".3f"),
    )


def _name_table(lines: Sequence[LeagueLine]) -> Table:
    """Show named effects and times of each series and size; draws of one size differ only in the held-out rows."""
    return table_of(
        "Discovery: time of a draw, effects named and in how many draws",
        {(line.series, line.learned): line for line in lines}.values(),
        ("series", "series"),
        ("rows", "learned", "d"),
        ("median", "seconds_median", ".1f", "s"),
        ("longest", "seconds_worst", ".1f", "s"),
        ("names", lambda line: ", ".join(f"{name} {count}" for name, count in line.names.items()) or "none"),
    )


def _bar_table(result: LeagueResult) -> Table:
    return table_of(
        "Bars",
        result.bars,
        ("series", "series"),
        ("rows", lambda bar: str(bar.rows)),
        ("bar", "what"),
        ("wanted", bar_words),
        ("reached", lambda bar: Number(bar.reached, 4)),
        ("met", lambda bar: "yes" if bar.met else "no"),
    )
