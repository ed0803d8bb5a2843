"""Parts of README and chapter ``figures`` that are made from tests/evidence/results: nothing there is typed by hand."""

from __future__ import annotations

from typing import Any

from tests.evidence.skeleton import ROOT, Limit, program, stated_results, words

README_ROWS: tuple[tuple[str, str, str], ...] = (
    (
        "a real UR10, 300 readings to learn from: mean error at the others",
        "{C_all_geometry} mm by geometry, **{C_all} mm** with discovery; worst of {rows[0][3]} draws {rows[0][8]} times"
        " that; {rows[0][9]} within the stated 95 %",
        "league",
    ),
    (
        "a real UR5, 300 readings to learn from: mean error at 20 random poses (published from 1000: 0.155 mm)",
        "{UR5_published_geometry} mm by geometry, **{UR5_published} mm** with discovery; worst of {rows[4][3]} draws"
        " {rows[4][8]} times that; {rows[4][9]} within the stated 95 %",
        "league",
    ),
    (
        "ten simulated cells, targets driven to and measured, UR10 and UR5",
        "{left_ratio} and {right_ratio} times less error; worst cell {rows[3][1]} and {rows[3][2]} times the floor",
        "targets",
    ),
    ("hidden effects named exactly; false names", "{rows[6][2]}; {rows[6][1]}", "sealed"),
    (
        "check of a calibration: unchanged cells valid; changes of three times the visible size found",
        "{valid}; {found}",
        "check",
    ),
)
"""What the README says: the figure, its value by figures and ``rows`` of the first table, and the program."""
ORDER = ("league", "twin", "sealed", "paper", "parameter_sets", "targets", "check", "coverage", "gross_errors", "peers")
"""Programs in the order of the chapter; others follow by name."""


def renew() -> None:
    """Renew README and chapter, where they stand."""
    from tests.handbook.declarations import with_declarations

    for path in (ROOT / "README.md", ROOT / "cellapp" / "docs" / "figures.md"):
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
        f"| {what} | {value.format_map(known[name])} | [{name}](cellapp/docs/figures.md#{_anchor(name)}) |"
        for what, value, name in README_ROWS
    ]
    return "\n".join(
        ["<!-- declared: readme -->", "| figure | value | section |", "| --- | --- | --- |", *rows, "<!-- end -->", ""]
    )


def figures_part() -> str:
    """The sections of all programs that have results, with the markers."""
    results = stated_results()
    names = sorted(results, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name))
    sections = "\n\n".join(_section(name, results[name]) for name in names)
    return f"<!-- declared: figures -->\n{sections}\n<!-- end -->\n"


def _section(name: str, stated: dict[str, Any]) -> str:
    missed = [limit for limit in stated["limits"] if not Limit(**limit).met]
    facts = [f"Date: {stated['date']}", f"commit: {stated['commit']}"]
    facts += [f"{stated['cases']} cases"] if stated["cases"] > 1 else []
    facts += [f"seeds: {stated['seeds']}"] if stated["seeds"] else []
    if stated["limits"]:
        facts.append(f"{len(missed)} of {len(stated['limits'])} limits missed" if missed else "all limits kept")
    about = " ".join((program(name).__doc__ or "").split())
    block = f"```sh dev\n{stated['command']}\n```"
    shown = words({**stated, "limits": missed})
    return "\n\n".join([f"## {stated['title']}", about, block, "; ".join(facts) + ".", shown])


def _anchor(name: str) -> str:
    kept = (one for one in program(name).TITLE.lower() if one.isalnum() or one in " -")
    return "".join(kept).replace(" ", "-")
