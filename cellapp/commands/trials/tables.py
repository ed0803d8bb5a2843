"""Tables of the trials for terminal and handbook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.commands.trials.blind_matrix import MatrixResult
from cellapp.commands.trials.judge_records import (
    OUTCOMES,
    THRESHOLD,
    VERDICTS,
    CleanCounts,
    EndState,
    JudgeResult,
    OutcomeCounts,
    PosteriorScore,
    Scores,
    Spread,
    TargetScore,
)
from cellapp.commands.trials.paper import PaperResult
from cellapp.commands.trials.parameter_sets import ParameterSetsResult
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.view.table import Cell, Column, Number, Table, number_column
from cellapp.ground.times import day_of

_MM = ".4f"
_CELLS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "Cells: visible effects, exactly named": {
        "one": ("one", "visible: exactly its name"),
        "several": ("pair, triple", "visible: exactly their names"),
        "look-alikes": ("pair", "visible look-alikes: exactly their names"),
        "second": ("one, pair, triple", "second names"),
    },
    "Cells: nothing hidden, laws outside the library, flipped signs": {
        "false": ("none", "false names, by arm"),
        "unknown": ("none", "false unknown effects, by arm"),
        "called": ("outside", "visible: called unknown"),
        "described": ("outside", "visible: right channel and variables"),
        "sign": ("flipped", "visible: called unknown, opposite sign said"),
    },
}
"""Tables of the cells: title, headings, and the target (kind, target) under each heading."""
_END = (Column("held out"), Column("verdicts"))


def parameter_set_tables(result: ParameterSetsResult) -> list[Table]:
    """Redundant and reduced models, one table for each arm."""
    columns = (
        Column("set (parameters), solver"),
        number_column("iterations", "g"),
        Column("converged"),
        number_column("mean", ".4g", "mm"),
        number_column("max", ".4g", "mm"),
    )
    return [
        Table(
            f"Arm {arm}: redundant and reduced models, medians over seeds",
            columns,
            tuple(
                (
                    f"{trial.parameter_set} ({trial.parameters}), {trial.solver}",
                    trial.iterations,
                    f"{trial.converged} of {trial.seeds}",
                    trial.mean_mm,
                    trial.max_mm,
                )
                for trial in trials
            ),
        )
        for arm, trials in result.arms.items()
    ]


def paper_tables(result: PaperResult) -> list[Table]:
    """The paper's methods over seeds beside the paper, and position errors at both tracker stations."""
    rows: list[tuple[Cell, ...]] = [
        (method, entry.median, entry.worst, entry.paper) for method, entry in result.cooperative_mm.items()
    ]
    gain = (result.gain.median, result.gain.worst, result.gain.paper)
    rows.append(
        ("proposed below method_1", *(None if share is None else Number(100 * share, 1, "%") for share in gain))
    )
    columns = (Column("method"), *(number_column(title, _MM) for title in ("median", "worst", "paper")))
    title = f"Mean cooperative error [mm], {len(result.trials)} simulated cells"
    positions = [trial.position_mm for trial in result.trials]
    moved = [trial.moved_mm for trial in result.trials]
    tables = [Table(title, columns, tuple(rows))]
    for heading, trials in (("Mean position error [mm]", positions), ("At another tracker station [mm]", moved)):
        shown: list[tuple[Cell, ...]] = []
        for name, stages in trials[0].items():
            for stage in stages:
                values = sorted(arms[name][stage] for arms in trials if stage in arms[name])
                shown.append((f"{name}, {stage}", values[len(values) // 2], values[-1]))
        headings = (Column("arm, model"), number_column("median", _MM), number_column("worst", _MM))
        tables.append(Table(heading, headings, tuple(shown)))
    return tables


def judge_tables(result: Scores) -> list[Table]:
    """Targets, then one table for each kind of trial; the last one lists the misses."""
    tables = [_target_table(result.targets)]
    for title, groups in (("One hidden effect", result.one), ("Several hidden effects", result.pair)):
        rows = [
            row
            for name, group in groups.items()
            for which, counts in (("", group.visible), (", below", group.below))
            if (row := _count_row(f"{name} (look-alikes){which}" if group.look_alikes else name + which, counts))
        ]
        if groups:
            columns: tuple[Column, ...] = (
                Column("effect"),
                Column("visible um"),
                Column("beyond law um"),
                number_column("n", "d"),
                number_column("named", "d"),
                Column("otherwise"),
                number_column("in answer set", "d"),
                *_END,
            )
            tables.append(Table(title, columns, tuple(rows)))
    if result.none:
        columns = (Column("arms"), *(number_column(c, "d") for c in ("n", "false names", "false unknown")), *_END)
        tables.append(Table("Nothing hidden", columns, tuple(_clean_row(*entry) for entry in result.none.items())))
    if result.outside:
        tables.append(_outside_table(result))
    tables += [_posterior_table(score) for score in result.posteriors]
    if result.misses:
        tables.append(_miss_table(result))
    return tables


def judge_sentences(result: JudgeResult) -> list[str]:
    """How the tables came about: threshold, abbreviations, speed, date, seed, program."""
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
            f" {cpu.median:.1f} and {cpu.max:.1f} s), {result.jobs} at a time, a thread each."
        )
    if result.judged_by_other_source:
        said.append(
            f"{result.judged_by_other_source} runs were judged by another state of the program than the present"
            " one; --again judges them again."
        )
    said += [f"Not judged: {failure}." for failure in result.failed]
    said.append(
        f"{result.date}; {result.program}, source {result.source}; {sealed.runs} runs of {sealed.stops}"
        f" stops an arm, profile {sealed.profile}, {setup_words(sealed.setup)},"
        f" seed {sealed.seed}, sealed {day_of(sealed.written)} by {sealed.program}."
    )
    return said


def setup_words(setup: Setup) -> str:
    """The conditions of a set of trials in words."""
    said = [f"kind {setup.hides}", f"noise {setup.noise}", f"laws {setup.laws}", f"ranges {setup.ranges}"]
    said.append(f"masses {100 * setup.mass_error:.0f} % off")
    return ", ".join([*said, *([] if setup.stated else ["no stated uncertainty"])])


def matrix_tables(result: MatrixResult) -> list[Table]:
    """Targets over all cells, stated probabilities, and the shares that each cell reached."""
    return [
        _target_table(result.targets),
        *(_posterior_table(score) for score in result.posteriors),
        *(_cell_table(title, result, headings) for title, headings in _CELLS.items()),
    ]


def _cell_table(title: str, result: MatrixResult, headings: Mapping[str, tuple[str, str]]) -> Table:
    """The cells that have one of some targets, each named by kind and target, and the targets that any cell has."""
    reached = {
        cell.name: {(one.kind, one.target): f"{one.reached}/{one.n}" for one in cell.targets} for cell in result.cells
    }
    used = {heading: target for heading, target in headings.items() if any(target in cell for cell in reached.values())}
    rows = []
    for cell in result.cells:
        if reached[cell.name].keys() & set(used.values()):
            pace = cell.seconds_an_arm
            spent = (None, None) if pace is None else (pace.median, pace.max)
            rows.append((cell.name, *(reached[cell.name].get(target, "") for target in used.values()), *spent))
    seconds = number_column("median s", ".1f"), number_column("longest", ".1f")
    return Table(title, (Column("cell"), *(Column(heading) for heading in used), *seconds), tuple(rows))


def matrix_sentences(result: MatrixResult) -> list[str]:
    """How the tables came about."""
    said = [f"Visible: {THRESHOLD}."]
    if result.seconds_an_arm is not None:
        pace = result.seconds_an_arm
        said.append(f"Discovery of one arm: median {pace.median:.1f} s, longest {pace.max:.1f} s.")
    said += [f"Not judged: {failure}." for failure in result.failed]
    runs = sum(cell.runs for cell in result.cells)
    return [
        *said,
        f"{result.date}; {result.program}, source {result.source}; {runs} runs in {len(result.cells)} cells.",
    ]


# -- inside -----------------------------------------------------------------------------------------------------------


def _target_table(targets: Sequence[TargetScore]) -> Table:
    columns = tuple(Column(title) for title in ("kind", "target", "wanted", "reached", "share", "", "met"))
    rows = []
    for target in targets:
        sign = "at most" if target.at_most else "at least"
        wanted = f"{sign} {100 * target.wanted:.0f} %" if target.reached is not None else f"{sign} {target.wanted:g}"
        if target.n < target.trials_wanted:
            wanted += f" of {target.trials_wanted}"
        met = {True: "yes", False: "MISSED" if target.missed else "no", None: "too few"}[target.met]
        reached = f"{target.n} statements" if target.reached is None else f"{target.reached} of {target.n}"
        share = Number(target.share, 3) if target.reached is None else Number(100 * target.share, 1, "%")
        rows.append((target.kind, target.target, wanted, reached, share, "bar" if target.bar else "", met))
    return Table("Sealed trials: targets", columns, tuple(rows))


def _posterior_table(score: PosteriorScore) -> Table:
    columns = (Column("stated"), number_column("n", "d"), *(number_column(c, ".3f") for c in ("mean stated", "true")))
    rows = tuple((f"{one.low:.1f} to {one.high:.1f}", one.n, one.stated, one.true) for one in score.bins)
    return Table(f"Stated probabilities, {score.about}: Brier score {score.brier:.3f}", columns, rows)


def _count_row(name: str, counts: OutcomeCounts) -> tuple[Cell, ...] | None:
    if not counts.n:
        return None
    otherwise = ", ".join(f"{word} {counts.count(word)}" for word in OUTCOMES[1:] if counts.count(word))
    visible = _range(counts.visible_um)
    return (
        name,
        visible,
        _range(counts.beyond_law_um),
        counts.n,
        counts.named,
        otherwise or "-",
        counts.in_answer_set,
        *_end(counts),
    )


def _clean_row(what: str, counts: CleanCounts) -> tuple[Cell, ...]:
    return what, counts.n, counts.false_names, counts.false_unknown, *_end(counts)


def _outside_table(result: Scores) -> Table:
    titles = ("n", "called unknown", "described", "in part", "false names")
    columns = (Column("law"), Column("visible um"), *(number_column(title, "d") for title in titles), *_END)
    rows: list[tuple[Cell, ...]] = []
    for name, group in result.outside.items():
        counts = (group.n, group.unknown, group.right, group.part, group.false_names)
        rows.append((name, _range(group.visible_um), *counts, *_end(group)))
    return Table("Outside the library", columns, tuple(rows))


def _miss_table(result: Scores) -> Table:
    titles = ("run", "hidden (visible um)", "found", "or / described", "verdict")
    rows = tuple(
        (f"{miss.run} {miss.arm}", miss.hidden or "nothing", miss.found or "nothing", miss.said, miss.verdict,
         miss.to_drawn)
        for miss in result.misses
    )  # fmt: skip
    return Table("Misses", (*(Column(title) for title in titles), number_column("held out", ".3f")), rows)


def _end(state: EndState) -> tuple[Cell, Cell]:
    ratio = state.heldout_to_drawn
    verdicts = " ".join(f"{word[0].upper()}{count}" for word, count in state.verdicts.items())
    return None if ratio is None else f"{ratio.median:.3f}, {ratio.max:.3f}", verdicts


def _range(spread: Spread | None) -> str:
    if spread is None:
        return ""
    low, high = f"{spread.min:.0f}", f"{spread.max:.0f}"
    return low if low == high else f"{low}-{high}"
