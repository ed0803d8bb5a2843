"""Parts of README and chapter ``figures`` that are made from tests/evidence/results: nothing there is typed by hand."""

from __future__ import annotations

from typing import Any

from tests.evidence.skeleton import ROOT, Limit, program, stated_results, words

README_ROWS: tuple[tuple[str, str, str], ...] = (
    (
        "a real UR10, 300 readings, mean held-out error",
        "{C_all_geometry} mm by geometry, **{C_all} mm** with discovery",
        "league",
    ),
    (
        "a real UR5, 300 readings, 20 random poses",
        "{UR5_published_geometry} mm, **{UR5_published} mm** (published from 1000: 0.155 mm)",
        "league",
    ),
    (
        "the simulated cell, targets measured, left and right",
        "{left_nominal} and {right_nominal} mm, compensated **{left_compensated} and {right_compensated} mm**",
        "twin",
    ),
    ("the whole simulated cell, 400 stops, on an AMD EPYC", "{run}, {memory}", "times"),
    (
        "ten simulated cells with mixed effects, targets",
        "{left_ratio} and {right_ratio} times less error, {left_of_floor} and {right_of_floor} times the floor",
        "targets",
    ),
    ("distance between the arms; the published method has 0.168 mm", "{proposed}", "paper"),
    ("hidden effects named exactly; false names", "{exact}; {false}", "sealed"),
    (
        "geometry of an arm from 400 configurations, against one `lstsq` and the fastest other library",
        "{hayati_400_lstsq} times; {hayati_400_faster} times faster, the same error",
        "peers",
    ),
    ("stated 95 % intervals that hold the truth", "{left} and {right}", "coverage"),
    (
        "check of a calibration: unchanged cells valid; changes of three times the visible size found",
        "{valid}; {found}, in {found_stops} stops (mean)",
        "check",
    ),
    (
        "Escape, Ctrl-C or a click on STOP while emulated arms move: stop command at both controllers",
        "worst of {presses} presses {worst}",
        "presses",
    ),
    (
        "attacks on emulated arms that move: stop at both; readings lost, doubled or false",
        "{attacks}: within {stop}; {wrong}",
        "wire",
    ),
    ("faults while measuring: readings lost, doubled or false", "{faults}: {wrong}", "campaigns"),
)
"""What the README says: the figure, its value by the names of the program's figures, and the program."""
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
    rows = [
        f"| {what} | {value.format_map(results[name]['figures'])} | [{name}](cellapp/docs/figures.md#{_anchor(name)}) |"
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
