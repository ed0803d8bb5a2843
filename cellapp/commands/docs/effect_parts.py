"""Declaration of an effect as Markdown for the handbook."""

from __future__ import annotations

import textwrap

from cellapp.robot.effects import DriverVariable, Effect

_WIDTH = 120
"""Line width of the Markdown files."""
_GENERAL_PLACE = {"link_bending": "the link", "unknown": "a part of the cell"}


def declared_part(effect: Effect) -> str:
    """Return an effect's declaration as Markdown, between markers: cause, laws, usual size, checks, further stops."""
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
    """State what an effect depends on, its laws as named in results, and what is impossible."""
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
