"""The parts of chapters that repeat what the code declares: verbs, effects with their laws, results with schemas."""

from __future__ import annotations

import re
import textwrap

from cellapp.commands.docs.handbook import WIDTH, declared_part
from cellapp.commands.docs.keys import KEYS
from cellapp.commands.docs.schema import results_by_name, written_results
from cellapp.commands.registry import GROUPS, PANEL, name_of, records
from cellapp.interfaces.cli.top import REQUESTS
from cellapp.robot.effects import EFFECTS
from tests.evidence.page import readme_part, validation_part
from tests.sure import sure

_DECLARED = re.compile(r"<!--declared:(\w+)-->\n.*?<!--end-->\n", re.DOTALL)


def with_declarations(text: str) -> str:
    """The text with the parts that repeat declarations (between markers) renewed: verbs, effects, results as JSON."""
    lists = {"results": results_part, "verbs": verbs_part, "keys": keys_part}
    lists |= {"validation": validation_part, "readme": readme_part}
    return _DECLARED.sub(
        lambda match: lists[match[1]]() if match[1] in lists else declared_part(EFFECTS[match[1]]), text
    )


def verbs_part() -> str:
    """Every verb, what it does, whether it moves arms, its chapter: a Markdown table with its markers."""
    verbs = {verb.name.split()[0]: verb for verb in reversed(records())}
    others = {word: (words, verbs[word].chapter) for word, words in GROUPS.items()}
    others["stop"] = REQUESTS["stop"], "faults"
    rows, shown = [], ""
    for word, panel in PANEL.items():
        verb = verbs.get(name_of(word))
        words, chapter = others.get(word) or (sure(verb).summary, sure(verb).chapter)
        moves = "**yes**" if verb is not None and verb.moves_arms else ""
        start = f"| {panel if panel != shown else ''} | [`cellapp {name_of(word)}`]({chapter}.md) |"
        rows.append(f"{start} {words} | {moves} |")
        shown = panel
    head = ["| | command | what it does | moves the arms |", "| --- | --- | --- | --- |"]
    return "\n".join(["<!--declared:verbs-->", *head, *rows, "<!--end-->", ""])


def keys_part() -> str:
    """Every meaning of the terminal application with its key: a Markdown table with its markers."""
    rows = [f"| {key.shown} | {key.meaning} |" for key in KEYS.values()]
    head = ["| key | what it does, where a screen has it |", "| --- | --- |"]
    return "\n".join(["<!--declared:keys-->", *head, *rows, "<!--end-->", ""])


def results_part() -> str:
    """The schemas of all results of verbs, with the markers around them."""
    names = ", ".join(f"`{name}`" for name in results_by_name(written_results(records())))
    return f"<!--declared:results-->\n{textwrap.fill(names, WIDTH, break_on_hyphens=False)}.\n<!--end-->\n"
