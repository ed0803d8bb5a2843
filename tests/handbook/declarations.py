"""The parts of chapters that repeat what the code declares: effects with their laws, results with their schemas."""

from __future__ import annotations

import re
import textwrap

from cellapp.commands.schemas import VERB_RESULTS
from cellapp.ground.results import Result
from cellapp.robot.effects import EFFECTS, DriverVariable, Effect

_DECLARED = re.compile(r"<!-- declared: (\w+) -->\n.*?<!-- end -->\n", re.DOTALL)
_WIDTH = 120
"""Columns of the Markdown files."""
_GENERAL_PLACE = {"link_bending": "the link", "unknown": "a part of the cell"}


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


def declared_part(effect: Effect) -> str:
    """What an effect declares, as Markdown: cause, laws, usual size, checks, further stops; with markers around it."""
    meaning = effect.meaning.at(_GENERAL_PLACE.get(effect.slug, "the joint"))
    known = "" if meaning.size_source == "none" else f" ({meaning.size_source})"
    parts = [
        _wrapped(f"**Cause.** {meaning.cause}"),
        *_laws(effect),
        _wrapped(f"**Usual size**{known}. {meaning.size}."),
        "**Check or mend**",
        "\n".join(_wrapped(f"- {line}") for line in meaning.check),
        "**What settles it**",
        "\n".join(_wrapped(f"- {line}") for line in meaning.settle),
    ]
    return f"<!-- declared: {effect.slug} -->\n" + "\n\n".join(parts) + "\n<!-- end -->\n"


def _laws(effect: Effect) -> list[str]:
    """What an effect depends on, its laws as results name them, and what is not possible."""
    parts = []
    if effect.variables:
        parts.append(_wrapped(f"**Depends on** {', '.join(sorted(_variable(one) for one in effect.variables))}."))
    if effect.forms:
        names = [(f"`{form.name}`: " if form.name else "") + form.words for form in effect.forms]
        parts += ["**Laws**", "\n".join(_wrapped(f"- {line}") for line in names)]
    if effect.impossible.sign:
        parts.append(_wrapped(f"**Impossible**, hence never named: {effect.impossible.sign}."))
    return parts


def _variable(variable: DriverVariable) -> str:
    return "joint angle" if variable is DriverVariable.JOINT_ANGLE else variable.value


def _wrapped(text: str) -> str:
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(text, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
