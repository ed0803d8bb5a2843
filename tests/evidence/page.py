"""Parts of README and chapter ``validation`` that are made from tests/evidence/results: nothing is typed."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellapp.commands.docs.handbook import WIDTH
from tests.evidence.skeleton import ROOT, Limit, program, stated_results, words

README_ROWS: tuple[tuple[str, str, str], ...] = (
    (
        "real UR10, 300 readings learnt: mean error at the others",
        "{C_all_geometry} mm by geometry, **{C_all} mm** discovered (worst of {rows[0][3]}: {rows[0][9]} times);"
        " {rows[0][10]} within the stated 95 %",
        "league",
    ),
    (
        "real UR5, likewise, at 20 random poses (published: 0.155 mm)",
        "{UR5_published_geometry} mm by geometry, **{UR5_published} mm** discovered (worst of {rows[4][3]}:"
        " {rows[4][9]} times); {rows[4][10]} within the stated 95 %",
        "league",
    ),
    (
        "ten simulated cells: measured targets",
        "error {left_ratio} (UR10) and {right_ratio} (UR5) times smaller; {rows[0][6]} floors (UR10: mean, worst)",
        "targets",
    ),
    ("hidden effects named exactly; false names", "{rows[6][2]}; {rows[6][1]}", "sealed"),
    ("`check`: unchanged cells valid; changes of 3 times the visible size found", "{valid}; {found}", "check"),
)
"""What the README says: the figure, its value by figures and ``rows`` of the first table, and the program."""


@dataclass(frozen=True)
class Shown:
    """What the chapter shows of a program: a question with its conditions, cells of the first table, sentences.

    Attributes
    ----------
    question : str
        May hold ``{NAME}``: a figure, ``cases``, or ``rows`` of the first table.
    columns, rows : tuple of int
        Columns and rows of the first table, all if empty.
    ends : bool
        Only the first and the last row of those that begin alike.
    said : bool
        Whether the program's own sentences follow.
    """

    question: str
    columns: tuple[int, ...] = ()
    rows: tuple[int, ...] = ()
    ends: bool = False
    said: bool = False


SHOWN: Mapping[str, Shown] = {
    "league": Shown(
        "How far off are real arms at readings of which nothing was learnt, after 300? Others measured a UR10, C and"
        " four months later D (Landgraf et al., CASE 2021), and a UR5 (Jacobi 2025; published: 0.155 mm at the 20"
        " poses, from 1000). Base and tool are not given; means over random choices of the 300.",
        columns=(0, 2, 4, 5, 7, 8, 10),
        rows=(0, 1, 2, 4),
    ),
    "more_readings": Shown(
        "Do more readings help? Mean held-out errors of the real arms, ± the standard error over the draws.",
        columns=(0, 1, 4),
        rows=tuple(range(22)),
        ends=True,
    ),
    "gross_errors": Shown(
        "What do wrong readings cost? 1, 3 or 5 % are moved by a length, or exchanged: mean held-out error over that"
        " from clean readings, the largest of the three.",
        columns=(0, 2, 5, 6),
        rows=(0, 3),
    ),
    "targets": Shown(
        "How well are new targets met? Simulated cells with hidden effects, half of them with laws of another shape:"
        " from the plan to targets that are driven to and measured. *Floor*: the error of measuring one point again.",
        columns=(0, 1, 3, 4, 6, 8),
    ),
    "twin": Shown(
        "What does one command reach on the simulated cell, left and right? Held-out mean error {rows[0][1]} and"
        " {rows[0][2]} by published geometry, {rows[1][1]} and {rows[1][2]} identified, {rows[3][1]} and {rows[3][2]}"
        " with the effects that were found; {rows[6][1]} and {rows[6][2]} at new targets, compensated."
    ),
    "sealed": Shown(
        "Are the names right? Simulated cells hide effects by physics that shares no code with the models; only a judge"
        " opens the truth. *Outside*: laws that the library lacks. False names are counted in arms that hide nothing.",
        columns=(0, 1, 2, 4, 6),
        rows=(6,),
    ),
    "check": Shown(
        "Does `check` find what changed, and nothing else? Simulated cells with one change of three times the size"
        " stated as visible: {found} found, {named} named, with {found_stops} stops (mean). Unchanged cells called"
        " valid, by model:",
        columns=(0, 1, 2, 3),
        rows=(0,),
    ),
    "coverage": Shown(
        "Do stated 95 % intervals of parameters hold the truth? Of two simulated arms at 100 stops {rows[0][2]} and"
        " {rows[1][2]} do."
    ),
    "paper": Shown(
        "Does cooperative accuracy follow Bai et al., ROBOT 45(3), 2023? Simulated cells whose geometry alone ends near"
        " the paper's error between the arms.",
        rows=(1, 2, 3),
    ),
    "parameter_sets": Shown(
        "Does a redundant model harm? With all 34 parameters of that paper unscaled Gauss-Newton converges in"
        " {rows[0][3]}, cellapp in {rows[1][3]} after {rows[1][2]} iterations, with the mean error of its own 27."
    ),
    "peers": Shown(
        "Is identification as good as in other libraries, and how fast? A UR10 off by 0.3 mm and 0.1 degrees with axes"
        " not quite parallel, which D-H rows (pybotics) cannot hold; noise 15 µm, one thread. Besides, figaroh takes"
        " cameras, any URDF and masses from motion.",
        columns=(0, 1, 3),
        rows=(0, 1, 3, 4),
    ),
    "times": Shown(
        "How long do commands of the simulated cell take? A: two idle cores; B: busy ones.", (0, 1, 2), (0, 1, 3)
    ),
    "presses": Shown(
        "How long from a key or a fault to the stop command at the last controller? Emulated cell, real terminal,"
        " measured before the last changes.",
        columns=(0, 1),
        rows=(0, 7, 15),
    ),
    "wire": Shown(
        "What happens under attack on keys, links, network, processes, by other accounts and programs, while both"
        " emulated arms move? {attacks} attacks, longest time to the stop of both {stop}; motions after a stop,"
        " programs left, readings lost, doubled or false: {wrong}."
    ),
    "campaigns": Shown(
        "Is anything lost, doubled or false, does anything collide, under faults of all kinds? {cases} simulated"
        " campaigns, {faults} faults: {wrong} times."
    ),
    "storm": Shown(
        "And over the wire, with 200 faults and 50 kills at random moments? {readings} readings stored, none lost or"
        " doubled. Twice an arm that had its motion already began to move after the other had the stop; it was braked."
    ),
    "pair": Shown(
        "How well is the pose of one flange in the other's frame known, where both have a 6-D probe? At 100 held-out"
        " stops of simulated cells (120 measured), median: {rows[0][1]} times the angle that two probes show of"
        " themselves, {rows[1][1]} mm. Within the stated 95 % bound: {rows[2][1]} in mm, {rows[3][1]} in mrad."
    ),
    "mutants": Shown("Do the tests notice a wrong program? Of mutants at random, {noticed} were noticed."),
    "bridge": Shown("Does a tracker bridge lose measurements under faults? {delivered} delivered, none twice."),
}
"""What the chapter shows, in its order: real arms first; other programs follow by name, whole."""
_UNTABLED = ("wire", "mutants", "twin", "coverage", "parameter_sets", "pair")
"""Programs whose first table is too long for the chapter, or stands in the words."""


def renew() -> None:
    """Renew README and chapter, where they stand."""
    from tests.handbook.declarations import with_declarations

    for path in (ROOT / "README.md", ROOT / "cellapp" / "docs" / "validation.md"):
        text = path.read_text("utf-8")
        path.write_text(with_declarations(text), encoding="utf-8", newline="\n")


def readme_part() -> str:
    """The README's table of figures, with its markers."""
    results = stated_results()
    rows = [
        f"| {what} | {value.format_map(_known(results[name]))} | [{name}](cellapp/docs/validation.md#{_anchor(name)}) |"
        for what, value, name in README_ROWS
    ]
    return "\n".join(
        ["<!--declared:readme-->", "| figure | value | section |", "| --- | --- | --- |", *rows, "<!--end-->", ""]
    )


def validation_part() -> str:
    """The sections of all programs that have results, with the markers."""
    results = stated_results()
    order = [*SHOWN]
    names = sorted(results, key=lambda name: (order.index(name) if name in order else len(order), name))
    sections = "\n\n".join(_section(name, results[name]) for name in names)
    return f"<!--declared:validation-->\n{sections}\n<!--end-->\n"


def _section(name: str, stated: dict[str, Any]) -> str:
    shown = SHOWN.get(name, Shown(" ".join((program(name).__doc__ or "").split())))
    missed = [limit for limit in stated["limits"] if not Limit(**limit).met]
    facts = [f"[{name}](../../tests/evidence/results/{name}.json)"]
    facts += [fact.removeprefix("not recorded").removeprefix(", ") for fact in (stated["date"], stated["commit"])]
    tables = [] if name in _UNTABLED else [_chosen(table, shown) for table in stated["tables"][:1]]
    said = stated["said"] if shown.said else []
    body = words({**stated, "tables": tables, "said": said, "limits": missed})
    question = shown.question.format_map(_known(stated))
    question = textwrap.fill(question, WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\n\n".join(filter(None, [f"## {stated['title']}", question, body, "; ".join(filter(None, facts)) + "."]))


def _known(stated: dict[str, Any]) -> dict[str, Any]:
    """What words about a program may hold."""
    rows = stated["tables"][0]["rows"] if stated["tables"] else []
    return {**stated["figures"], "cases": stated["cases"], "rows": rows}


def _chosen(table: dict[str, Any], shown: Shown) -> dict[str, Any]:
    """The rows and columns of a table that the chapter shows."""
    rows = [row for number, row in enumerate(table["rows"]) if not shown.rows or number in shown.rows]
    if shown.ends:
        near = [None, *(row[0] for row in rows), None]
        rows = [row for row, before, after in zip(rows, near, near[2:], strict=False) if not before == row[0] == after]
    columns = shown.columns or range(len(table["columns"]))
    return {
        "title": "",
        "columns": [table["columns"][place] for place in columns],
        "rows": [[row[place] for place in columns] for row in rows],
    }


def _anchor(name: str) -> str:
    kept = (one for one in program(name).TITLE.lower() if one.isalnum() or one in " -")
    return "".join(kept).replace(" ", "-")
