"""The parts of chapters that repeat what the code declares: effects with their laws, results with their schemas."""

from __future__ import annotations

import re

from cellapp.commands.docs.declared import declared_part
from cellapp.commands.schemas import VERB_RESULTS
from cellapp.ground.results import Result
from cellapp.robot.effects import EFFECTS

_DECLARED = re.compile(r"<!-- declared: (\w+) -->\n.*?<!-- end -->\n", re.DOTALL)


def with_declarations(text: str) -> str:
    """The text with the parts that repeat declarations (between markers) renewed: of effects, of results as JSON."""
    return _DECLARED.sub(
        lambda match: results_part() if match[1] == "results" else declared_part(EFFECTS[match[1]]), text
    )


def results_part() -> str:
    """Every result of a verb, its schema and what it says, as a Markdown table with the markers around it."""
    rows = [
        f"| `{one.model_fields['schema_'].default}` | {one.model_fields['version'].default} | {_first_sentence(one)} |"
        for one in VERB_RESULTS
    ]
    head = ["| schema | version | what it holds |", "| --- | --- | --- |"]
    return "\n".join(["<!-- declared: results -->", *head, *rows, "<!-- end -->", ""])


def _first_sentence(result: type[Result]) -> str:
    words = " ".join((result.__doc__ or "").split("\n\n")[0].split())
    return words.replace("``", "`")
