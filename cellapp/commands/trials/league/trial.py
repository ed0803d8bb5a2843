"""All draws of the league, means over draws, and the bars that they must meet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from cellapp.commands.trials.league.draws import DRAWS, DrawTask, LeagueDraw, TurnScore
from cellapp.commands.trials.league.series import SERIES, Group, Rows, draw_rows, parse_entrants, series_texts
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Record, Result
from cellapp.ground.version import __version__

CURVE_SERIES = "C"
"""The longest series, used for the learning curve."""
CURVE_ROWS = (100, 200, 300, 600, 1200, 2200)
"""Sizes of the learning curve; the rows beyond the largest size are held out for all sizes."""
_BAR_ROWS: Rows = 300
"""Size at which no draw may be much worse than the mean."""
_MOST_ABOVE_MEAN = 1.15
_WITHIN_95 = (0.90, 0.98)
"""Range of the share of measured coordinates that stated 95 % intervals must contain."""


BarKind = Literal[
    "held-out error [mm]", "orientation error [mrad]", "worst draw to mean", "within 95 %", "orientations within 95 %"
]


class LeagueLine(Record):
    """A series at one size: means over its draws on one group of held-out rows.

    Attributes
    ----------
    draws, learned, held_out : int
        Number of draws; rows of a draw that were learned from and held out.
    geometry_mm, network_mm, discovery_mm : float
        Mean over draws of the mean position error; of the network None where it was not asked for.
    worst_to_mean : float
        Largest mean position error of a draw, over the mean of all draws; discovery.
    within_95 : float
        Share of coordinates within the stated 95 % intervals, of all draws.
    names : mapping
        Effect -> number of draws in which discovery accepted it.
    verdicts : mapping
        Verdict -> number of draws.
    seconds_median, seconds_worst : float
        Wall time of discovery [s].
    published_mm : float or None
        Mean position error that the authors of the data published for these held-out rows, learned from all others.
    turned : TurnScore, optional
        Means over the draws of the scores of orientations, where they were measured.
    """

    series: str
    rows: Rows
    group: Group
    draws: int
    learned: int
    held_out: int
    geometry_mm: float
    network_mm: float | None
    discovery_mm: float
    worst_to_mean: float
    within_95: float
    names: Mapping[str, int]
    verdicts: Mapping[str, int]
    seconds_median: float
    seconds_worst: float
    published_mm: float | None
    turned: TurnScore | None = None
    omitted_when_none = frozenset({"turned"})


class LeagueBar(Record):
    """A bar, what was reached, and whether it is met; None is no limit on that side."""

    series: str
    rows: Rows
    what: BarKind
    least: float | None
    most: float
    reached: float
    met: bool


class LeagueResult(Result, schema="cellapp-trials-league"):
    """``trials league``: a line for each series, size and group of held-out rows, the bars, and every draw.

    ``curve`` and ``curve_draws`` are those of the learning curve, empty where it was not asked for; ``failed`` names
    the draws that failed, and why.
    """

    date: str
    program: str
    jobs: int
    seeds: int
    lines: tuple[LeagueLine, ...]
    bars: tuple[LeagueBar, ...]
    draws: tuple[LeagueDraw, ...]
    curve: tuple[LeagueLine, ...] = ()
    curve_draws: tuple[LeagueDraw, ...] = ()
    failed: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Return draws that failed and bars that are missed, in words."""
        return [
            *self.failed,
            *(
                f"series {bar.series}, {bar.rows} rows: {bar.what} is {bar.reached:.3f}, {bar_words(bar)}"
                for bar in self.bars
                if not bar.met
            ),
        ]


def bar_words(bar: LeagueBar) -> str:
    """State the limits in words."""
    return f"at most {bar.most:g}" if bar.least is None else f"{bar.least:g} to {bar.most:g}"


def league_trials(
    series: Sequence[str],
    rows: Sequence[Rows],
    seeds: Sequence[int],
    work: Work = IN_PLACE,
    *,
    data: Path,
    profiles: Path,
    network: bool = False,
    curve: bool = False,
) -> LeagueResult:
    """Run every series with every number of rows over several seeds.

    Parameters
    ----------
    data, profiles : Path
        Folders of the series and of their profiles.
    network : bool
        Train the residual networks of ``calibrate`` too; slow.
    curve : bool
        Also learn from 100 to 2200 rows of series C, with the same held-out rows each time.

    Raises
    ------
    InputError
        If a series is missing, or has fewer rows than requested.
    Cancelled
        On request.
    """
    if not (series and rows and seeds):
        raise InputError("trials league: ask for at least one series, one number of rows and one seed")
    texts = series_texts([*series, CURVE_SERIES] if curve else series, data, profiles)
    tasks = [
        DrawTask(series=name, rows=size, seed=seed, network=network)
        for name in dict.fromkeys(series)
        for size in dict.fromkeys(rows)
        for seed in seeds
    ]
    curve_tasks = _curve_tasks(seeds) if curve else []
    every = [*tasks, *curve_tasks]
    entrants = parse_entrants(texts)
    for task in every:  # report too few rows before hours of work
        draw_rows(entrants[task.series], task.rows, task.seed, task.learnable)
    gathered = work.gather(DRAWS, "league", texts, every, "series {0.series}, {0.rows} rows, seed {0.seed}")
    draws = [draw for draw in gathered.results[: len(tasks)] if draw is not None]
    curve_draws = [draw for draw in gathered.results[len(tasks) :] if draw is not None]
    return results_of(draws, curve_draws, seeds=len(seeds), jobs=gathered.workers, failed=gathered.failed)


def results_of(
    draws: Sequence[LeagueDraw],
    curve_draws: Sequence[LeagueDraw],
    *,
    seeds: int,
    jobs: int,
    failed: tuple[str, ...] = (),
) -> LeagueResult:
    """Return lines and bars of draws over ``seeds`` seeds by ``jobs`` processes."""
    lines = _lines(draws)
    return LeagueResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        jobs=jobs,
        seeds=seeds,
        lines=lines,
        bars=_bars(lines),
        draws=tuple(draws),
        curve=_lines(curve_draws),
        curve_draws=tuple(curve_draws),
        failed=failed,
    )


def _curve_tasks(seeds: Sequence[int]) -> list[DrawTask]:
    return [
        DrawTask(series=CURVE_SERIES, rows=size, seed=seed, learnable=CURVE_ROWS[-1])
        for size in CURVE_ROWS
        for seed in seeds
    ]


def _lines(draws: Sequence[LeagueDraw]) -> tuple[LeagueLine, ...]:
    by_size = grouped(((draw.series, draw.rows), draw) for draw in draws)
    return tuple(_line(some, group) for some in by_size.values() for group in some[0].scores)


def _line(draws: Sequence[LeagueDraw], group: Group) -> LeagueLine:
    """Average the draws of one series and size."""
    first, scores = draws[0], [draw.scores[group] for draw in draws]
    errors = [score.discovery_mm for score in scores]
    networks = [score.network_mm for score in scores if score.network_mm is not None]
    seconds = [draw.seconds for draw in draws]
    return LeagueLine(
        series=first.series,
        rows=first.rows,
        group=group,
        draws=len(draws),
        learned=first.learned,
        held_out=scores[0].n,
        geometry_mm=float(np.mean([score.geometry_mm for score in scores])),
        network_mm=float(np.mean(networks)) if networks else None,
        discovery_mm=float(np.mean(errors)),
        worst_to_mean=max(errors) / float(np.mean(errors)),
        within_95=float(np.average([score.within_95 for score in scores], weights=[score.n for score in scores])),
        names=dict(Counter(name for draw in draws for name in dict.fromkeys(draw.names)).most_common()),
        verdicts=dict(Counter(draw.verdict for draw in draws).most_common()),
        seconds_median=float(np.median(seconds)),
        seconds_worst=max(seconds),
        published_mm=SERIES[first.series].published_mm if group == "published" else None,
        turned=_mean_turns([score.turned for score in scores if score.turned is not None]),
    )


def _mean_turns(scores: Sequence[TurnScore]) -> TurnScore | None:
    """Average orientation scores over draws; None if no orientation was measured."""
    if not scores:
        return None
    means = {name: float(np.mean([getattr(one, name) for one in scores])) for name in TurnScore.model_fields}
    return TurnScore(**means)


def _bars(lines: Sequence[LeagueLine]) -> tuple[LeagueBar, ...]:
    """Return the bars of every series and size, on all held-out rows; a single draw has no bar for its worst."""
    judged: dict[tuple[str, Rows], LeagueLine] = {}
    for line in lines:
        judged.setdefault((line.series, line.rows), line)  # the first line is that of all held-out rows
    bars = []
    for line in judged.values():
        most = SERIES[line.series].bars_mm.get(line.rows)
        if most is not None:
            bars.append(_bar(line, "held-out error [mm]", None, most, line.discovery_mm))
        if line.rows == _BAR_ROWS and line.draws > 1:
            bars.append(_bar(line, "worst draw to mean", None, _MOST_ABOVE_MEAN, line.worst_to_mean))
        bars.append(_bar(line, "within 95 %", *_WITHIN_95, line.within_95))
        if line.turned is not None:
            most = SERIES[line.series].bars_mrad.get(line.rows)
            if most is not None:
                bars.append(_bar(line, "orientation error [mrad]", None, most, line.turned.discovery_mrad))
            bars.append(_bar(line, "orientations within 95 %", *_WITHIN_95, line.turned.within_95))
    return tuple(bars)


def _bar(
    line: LeagueLine,
    what: BarKind,
    least: float | None,
    most: float,
    reached: float,
) -> LeagueBar:
    met = reached <= most and (least is None or reached >= least)
    return LeagueBar(series=line.series, rows=line.rows, what=what, least=least, most=most, reached=reached, met=met)
