"""Tables of blind trials for terminal and handbook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter

from cellapp.commands.trials.scoring import (
    OUTCOMES,
    VERDICTS,
    CleanCounts,
    EffectCounts,
    EndState,
    JudgeResult,
    Miss,
    OutcomeCounts,
    OutsideCounts,
    PosteriorScore,
    Scores,
    Spread,
    TargetScore,
)
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.view.table import Field, Number, Table, table_of
from cellapp.ground.counting import counted
from cellapp.ground.times import day_of


def judge_tables(result: Scores) -> list[Table]:
    """Show the targets, then one table for each kind of trial; the last one lists the misses."""
    effects = {"One hidden effect": result.one, "Several hidden effects": result.pair}
    return [
        _target_table(result.targets),
        *(_count_table(title, groups) for title, groups in effects.items() if groups),
        *([_clean_table(result.none)] if result.none else []),
        *([_outside_table(result.outside)] if result.outside else []),
        *map(_posterior_table, result.posteriors),
        *([_miss_table(result.misses)] if result.misses else []),
    ]


def judge_sentences(result: JudgeResult) -> list[str]:
    """State the conditions of the tables: threshold, abbreviations, speed, date, seed, program."""
    sealed = result.sealed
    wall, cpu = result.seconds_an_arm, result.cpu_seconds_an_arm
    said = [
        f"Visible: {result.threshold}, each hidden effect alone; below: not so, which counts for the targets of"
        " pairs and of the held-out error only. Held out: rms over that of the noise drawn at those stops, median and"
        f" worst. Verdicts: {', '.join(f'{word[0].upper()} {word}' for word in VERDICTS)}."
    ]
    if wall is not None and cpu is not None:
        said.append(
            f"Discovery of one arm: median {wall.median:.1f} s, longest {wall.max:.1f} s (processor"
            f" {cpu.median:.1f} and {cpu.max:.1f} s)."
        )
    if result.judged_by_other_source:
        said.append(
            f"{counted(result.judged_by_other_source, 'run was', 'runs were')} judged by another state of the"
            " program than the present one; --again judges them again."
        )
    said += [f"Not judged: {failure}." for failure in result.failed]
    said.append(
        f"{result.date}; {result.program}, source {result.source}; {counted(sealed.runs, 'run')} of"
        f" {counted(sealed.stops, 'stop')} an arm, profile {sealed.profile}, {setup_words(sealed.setup)},"
        f" seed {sealed.seed}, sealed {day_of(sealed.written)} by {sealed.program}."
    )
    return said


def setup_words(setup: Setup) -> str:
    """Describe the conditions of a set of trials."""
    said = [f"kind {setup.hides}", f"noise {setup.noise}", f"laws {setup.laws}", f"ranges {setup.ranges}"]
    said.append(f"masses {100 * setup.mass_error:.0f} % off")
    return ", ".join([*said, *([] if setup.stated else ["no stated uncertainty"])])


# -- inside -----------------------------------------------------------------------------------------------------------


def _target_table(targets: Sequence[TargetScore]) -> Table:
    return table_of(
        "Sealed trials: targets",
        targets,
        ("kind", "kind"),
        ("target", "target"),
        ("wanted", _wanted),
        ("reached", lambda one: f"{one.n} statements" if one.reached is None else f"{one.reached} of {one.n}"),
        ("share", lambda one: Number(one.share, 3) if one.reached is None else Number(100 * one.share, 1, "%")),
        ("", lambda one: "bar" if one.bar else ""),
        ("met", lambda one: {True: "yes", False: "MISSED" if one.missed else "no", None: "too few"}[one.met]),
    )


def _wanted(target: TargetScore) -> str:
    sign = "at most" if target.at_most else "at least"
    wanted = f"{sign} {100 * target.wanted:.0f} %" if target.reached is not None else f"{sign} {target.wanted:g}"
    return wanted + (f" of {target.trials_wanted}" if target.n < target.trials_wanted else "")


def _posterior_table(score: PosteriorScore) -> Table:
    return table_of(
        f"Stated probabilities, {score.about}: Brier score {score.brier:.3f}",
        score.bins,
        ("stated", lambda one: f"{one.low:.1f} to {one.high:.1f}"),
        ("n", "n", "d"),
        ("mean stated", "stated", ".3f"),
        ("true", "true", ".3f"),
    )


def _count_table(title: str, groups: Mapping[str, EffectCounts]) -> Table:
    """Show outcomes of runs that hide the same, separately for effects above and below the noise."""
    rows = [
        (f"{name} (look-alikes){which}" if group.look_alikes else name + which, counts)
        for name, group in groups.items()
        for which, counts in (("", group.visible), (", below", group.below))
        if counts.n
    ]
    return table_of(
        title,
        rows,
        ("effect", itemgetter(0)),
        ("visible µm", lambda row: _range(row[1].visible_um)),
        ("beyond law µm", lambda row: _range(row[1].beyond_law_um)),
        ("n", lambda row: row[1].n, "d"),
        ("named", lambda row: row[1].named, "d"),
        ("otherwise", lambda row: _otherwise(row[1])),
        ("in answer set", lambda row: row[1].in_answer_set, "d"),
        *_END,
    )


def _otherwise(counts: OutcomeCounts) -> str:
    return ", ".join(f"{word} {counts.count(word)}" for word in OUTCOMES[1:] if counts.count(word)) or "-"


def _clean_table(arms: Mapping[str, CleanCounts]) -> Table:
    return table_of(
        "Nothing hidden",
        arms.items(),
        ("arms", itemgetter(0)),
        ("n", lambda row: row[1].n, "d"),
        ("false names", lambda row: row[1].false_names, "d"),
        ("false unknown", lambda row: row[1].false_unknown, "d"),
        *_END,
    )


def _outside_table(laws: Mapping[str, OutsideCounts]) -> Table:
    return table_of(
        "Outside the library",
        laws.items(),
        ("law", itemgetter(0)),
        ("visible µm", lambda row: _range(row[1].visible_um)),
        ("n", lambda row: row[1].n, "d"),
        ("called unknown", lambda row: row[1].unknown, "d"),
        ("described", lambda row: row[1].right, "d"),
        ("in part", lambda row: row[1].part, "d"),
        ("false names", lambda row: row[1].false_names, "d"),
        *_END,
    )


def _miss_table(misses: Sequence[Miss]) -> Table:
    return table_of(
        "Misses",
        misses,
        ("run", lambda miss: f"{miss.run} {miss.arm}"),
        ("hidden (visible µm)", lambda miss: miss.hidden or "nothing"),
        ("found", lambda miss: miss.found or "nothing"),
        ("or / described", "said"),
        ("verdict", "verdict"),
        ("held out", "to_drawn", ".3f"),
    )


def _held_out(state: EndState) -> str:
    ratio = state.heldout_to_drawn
    return "" if ratio is None else f"{ratio.median:.3f}, {ratio.max:.3f}"


_END: tuple[Field, ...] = (
    ("held out", lambda row: _held_out(row[1])),
    ("verdicts", lambda row: " ".join(f"{word[0].upper()}{count}" for word, count in row[1].verdicts.items())),
)


def _range(spread: Spread | None) -> str:
    if spread is None:
        return ""
    low, high = f"{spread.min:.0f}", f"{spread.max:.0f}"
    return low if low == high else f"{low}-{high}"
