"""Parts of README and chapter ``validation`` that are made from tests/evidence/results: nothing is typed."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellapp.commands.docs.effect_parts import WIDTH
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
        "ten simulated cells: measured targets, UR10 and UR5",
        "error {left_ratio} and {right_ratio} times smaller; worst {rows[3][1]} and {rows[3][2]} times the floor",
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
        May hold ``{NAME}``: a figure, or ``cases``.
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
        "How far off are real arms at readings of which nothing was learnt? Series that others measured: one UR10, C"
        " and four months later D (Landgraf et al., CASE 2021), and a UR5 (Jacobi 2025; published: 0.155 mm at the 20"
        " poses, from 1000). Base and tool are not given; means over random choices of the rows to learn from.",
        columns=(0, 1, 2, 4, 5, 6, 7, 8, 10, 11),
        rows=(0, 1, 2, 4),
    ),
    "more_readings": Shown(
        "Do more readings help? Mean held-out errors of the real arms, ± the standard error over the draws; simulated"
        " arms alike.",
        columns=(0, 1, 3, 4),
        rows=tuple(range(22)),
        ends=True,
    ),
    "gross_errors": Shown(
        "What do wrong readings cost? 1, 3 or 5 % are moved by a length, or exchanged: mean held-out error over that"
        " from clean readings, the largest of the three.",
        columns=(0, 2, 3, 5, 6),
        rows=(0, 2, 3),
    ),
    "targets": Shown(
        "How well are new targets met? Simulated cells with hidden effects, half of them with laws of another shape:"
        " from the plan to targets that are compensated, driven to and measured. *Floor*: the error of measuring one"
        " point again.",
        rows=(0, 1, 2, 3, 4, 6),
    ),
    "twin": Shown("What does one command reach on the simulated cell? Mean errors.", rows=(0, 1, 3, 6)),
    "sealed": Shown(
        "Are the names right? Simulated cells hide effects by physics that shares no code with the models; only a judge"
        " opens the truth. *Outside*: laws that the library lacks; *narrow*: joints move over 10 to 50 degrees;"
        " *unstated*: no uncertainties given. False names are counted in arms that hide nothing.",
        columns=(0, 1, 2, 4, 6),
        rows=(1, 2, 4, 6),
        said=True,
    ),
    "check": Shown(
        "Does `check` find what changed, and nothing else? Calibrated simulated cells as they are, and with one change"
        " of three times the size stated as visible: {found} changes found, {named} named, with {found_stops} stops"
        " (mean). Unchanged cells that are called valid, by model:",
        columns=(0, 1, 2, 3),
        rows=(0,),
    ),
    "coverage": Shown("Do stated 95 % intervals of parameters hold the truth? Simulated arms, 100 stops.", (0, 2, 3)),
    "paper": Shown(
        "Does cooperative accuracy follow Bai et al., ROBOT 45(3), 2023? Simulated cells whose geometry alone ends near"
        " the paper's error between the arms; method 2 has its network in the tracker frame, the proposed one in the"
        " base frame.",
        rows=(1, 2, 3),
    ),
    "parameter_sets": Shown(
        "Does a redundant model harm? Sets of that paper, 100 stops; *plain* is unscaled Gauss-Newton.",
        rows=(0, 1, 4),
        columns=(1, 2, 3, 4),
    ),
    "peers": Shown(
        "Is identification as good as in other libraries, and how fast? A UR10 off by 0.3 mm and 0.1 degrees with axes"
        " not quite parallel, which D-H rows (*cellapp-dh*, pybotics) cannot hold; noise 15 µm, one thread. Besides,"
        " figaroh takes cameras, any URDF and masses from motion.",
        columns=(0, 1, 2, 3, 5),
        rows=(0, 1, 3, 4),
    ),
    "times": Shown(
        "How long do commands of the simulated cell take? A: two idle cores; B: busy ones.", (0, 1, 2), (0, 1, 2, 3)
    ),
    "presses": Shown(
        "How long from a key or a fault to the stop command at the last controller? Emulated cell, real terminal,"
        " measured before the last changes.",
        columns=(0, 1, 3),
        rows=(0, 1, 7, 8, 15),
    ),
    "wire": Shown(
        "What happens under attack? Keys, links, network, processes, other accounts and programs, both emulated arms"
        " moving: {attacks} attacks, longest time to the stop of both arms {stop}; motions after a stop, programs left,"
        " readings lost, doubled or false: {wrong}. No real arm was moved."
    ),
    "campaigns": Shown(
        "Is anything lost, doubled or false, does anything collide, under faults of all kinds? {cases} simulated"
        " campaigns, {faults} faults: {wrong} times."
    ),
    "storm": Shown(
        "And over the wire, with 200 faults and 50 kills at random moments? {readings} readings stored, none lost or"
        " doubled. Twice an arm that had its motion already began to move after the other controller had the stop; it"
        " was braked, too. The full storm was not repeated since."
    ),
    "mutants": Shown("Do the tests notice a wrong program? Of mutants at random, {noticed} were noticed."),
    "bridge": Shown("Does a tracker bridge lose measurements under faults? {delivered} delivered, none twice."),
}
"""What the chapter shows, in its order: real arms first; other programs follow by name, whole."""
_UNTABLED = ("wire", "mutants")
"""Programs whose first table is too long for the chapter."""


def renew() -> None:
    """Renew README and chapter, where they stand."""
    from tests.handbook.declarations import with_declarations

    for path in (ROOT / "README.md", ROOT / "cellapp" / "docs" / "validation.md"):
        text = path.read_text("utf-8")
        path.write_text(with_declarations(text), encoding="utf-8", newline="\n")


def readme_part() -> str:
    """The README's table of figures, with its markers."""
    results = stated_results()
    known = {
        name: {**stated["figures"], "rows": stated["tables"][0]["rows"] if stated["tables"] else []}
        for name, stated in results.items()
    }
    rows = [
        f"| {what} | {value.format_map(known[name])} | [{name}](cellapp/docs/validation.md#{_anchor(name)}) |"
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
    facts = [f"[{name}](../../tests/evidence/results/{name}.json)", stated["date"], stated["commit"]]
    facts += [f"{stated['cases']} cases"] if stated["cases"] > 1 else []
    if stated["limits"]:
        facts.append(f"{len(missed)} of {len(stated['limits'])} limits missed" if missed else "all limits kept")
    tables = [] if name in _UNTABLED else [_chosen(table, shown) for table in stated["tables"][:1]]
    said = stated["said"] if shown.said else []
    body = words({**stated, "tables": tables, "said": said, "limits": missed})
    question = shown.question.format_map({**stated["figures"], "cases": stated["cases"]})
    question = textwrap.fill(question, WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\n\n".join(filter(None, [f"## {stated['title']}", question, body, "; ".join(facts) + "."]))


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
