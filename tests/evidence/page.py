"""Parts of README and chapter ``figures`` that are made from tests/evidence/results: nothing there is typed by hand."""

from __future__ import annotations

from typing import Any

from tests.evidence.skeleton import ROOT, program, programs, stated_results, words

README_ROWS: tuple[tuple[str, str, str], ...] = (
    ("stated 95 % intervals that hold the truth", "{left} and {right}", "coverage"),
)
"""What the README says: the figure, its value by the names of the program's figures, and the program."""
ORDER = ("coverage",)
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


def without_results() -> list[str]:
    """Programs whose figures nobody has kept."""
    return [name for name in programs() if name not in stated_results()]


def _section(name: str, stated: dict[str, Any]) -> str:
    measured = f"Measured on {stated['date']}, commit {stated['commit']}: {stated['cases']} cases"
    seeds = f", seeds {stated['seeds']}" if stated["seeds"] else ""
    about = " ".join((program(name).__doc__ or "").split())
    block = f"```sh dev\n{stated['command']}\n```"
    return "\n\n".join([f"## {stated['title']}", about, block, f"{measured}{seeds}.", words(stated)])


def _anchor(name: str) -> str:
    kept = (one for one in program(name).TITLE.lower() if one.isalnum() or one in " -")
    return "".join(kept).replace(" ", "-")
