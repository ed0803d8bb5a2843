"""The parts of chapters that repeat what the code declares: verbs, effects with their laws, results with schemas."""

from __future__ import annotations

import re

from cellapp.commands.docs.effect_parts import declared_part
from cellapp.commands.docs.keys import KEYS
from cellapp.commands.registry import records
from cellapp.commands.schema import written_results
from cellapp.ground.results import Result
from cellapp.robot.effects import EFFECTS
from tests.evidence.page import validation_part, readme_part
from tests.interfaces.tui.states import states_table

_DECLARED = re.compile(r"<!-- declared: (\w+) -->\n.*?<!-- end -->\n", re.DOTALL)


def with_declarations(text: str) -> str:
    """The text with the parts that repeat declarations (between markers) renewed: verbs, effects, results as JSON."""
    lists = {"results": results_part, "verbs": verbs_part, "keys": keys_part, "states": states_part}
    lists |= {"validation": validation_part, "readme": readme_part}
    return _DECLARED.sub(
        lambda match: lists[match[1]]() if match[1] in lists else declared_part(EFFECTS[match[1]]), text
    )


def verbs_part() -> str:
    """Every verb, what it does, whether it moves arms, its chapter: a Markdown table with its markers."""
    rows = [
        f"| `cellapp {verb.name}` | {verb.summary} | {'**yes**' if verb.moves_arms else 'no'}"
        f" | [{verb.chapter}]({verb.chapter}.md) |"
        for verb in records()
    ]
    head = ["| command | what it does | moves the arms | chapter |", "| --- | --- | --- | --- |"]
    return "\n".join(["<!-- declared: verbs -->", *head, *rows, "<!-- end -->", ""])


def keys_part() -> str:
    """Every meaning of the terminal application with its key: a Markdown table with its markers."""
    rows = [f"| {key.shown} | {key.meaning} |" for key in KEYS.values()]
    head = ["| key | what it does, where a screen has it |", "| --- | --- |"]
    return "\n".join(["<!-- declared: keys -->", *head, *rows, "<!-- end -->", ""])


def states_part() -> str:
    """Every state of a run with what the screen Collect says in it: a Markdown table with its markers."""
    headings, *states = states_table()
    shown = [headings.index(name) for name in ("state", "Collect")]
    rows = [f"| {' | '.join(' '.join(row[place].split()) for place in shown)} |" for row in (headings, *states)]
    return "\n".join(["<!-- declared: states -->", rows[0], "| --- | --- |", *rows[1:], "<!-- end -->", ""])


def results_part() -> str:
    """Every result of a verb, its schema and what it says, as a Markdown table with the markers around it."""
    rows = [
        f"| `{one.model_fields['schema_'].default}` | {one.model_fields['version'].default} | {_first_sentence(one)} |"
        for one in written_results(records())
    ]
    head = ["| schema | version | what it holds |", "| --- | --- | --- |"]
    return "\n".join(["<!-- declared: results -->", *head, *rows, "<!-- end -->", ""])


def _first_sentence(result: type[Result]) -> str:
    words = " ".join((result.__doc__ or "").split("\n\n")[0].split())
    return words.replace("``", "`")
