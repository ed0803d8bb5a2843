"""Templates of the HTML pages."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cellapp.commands.view.acceptance_words import VERDICT_TITLES

if TYPE_CHECKING:
    from jinja2 import Template

_COMMAND = re.compile(r"&#39;(cellapp [^&]+)&#39;")
"""A command in an escaped sentence."""
_SHA_256 = re.compile(r"[0-9a-f]{64}")


def template(name: str) -> Template:
    """Return a template of this package; texts are escaped, and a name without a value is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    environment = Environment(
        loader=PackageLoader("cellapp.interfaces", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup  # made by cellapp, without any text that a user wrote
    environment.filters["prose"] = lambda text: Markup(_COMMAND.sub(r"<code>\1</code>", str(escape(text))))
    environment.filters["is_hash"] = lambda text: bool(_SHA_256.fullmatch(text))
    environment.tests["verdict"] = VERDICT_TITLES.__contains__
    return environment.get_template(name)
