"""Templates of the HTML pages."""

from __future__ import annotations

import base64
import gzip
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.commands.view.words import VERDICT_TITLES

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


# ---------------------------------------------------------------------------------------------------------------------
# Plotly's script for the page: found in the installed package, compressed, as text. Plotly itself is not imported.


_FILE = Path("package_data", "plotly.min.js")
_NOTICE = re.compile(r"/\*\*?(.*?)\*/", re.DOTALL)
"""The first comment of the script: its copyright and licence."""
_NOTICE_BYTES = 1000
"""Bytes that contain the whole first comment."""
_LEVEL = 6
"""Compression level: higher ones take longer and save less than one per cent."""


@cache
def plotly_base64() -> str:
    """Return ``plotly.min.js``, compressed by gzip and encoded in base64; empty if the package or the file is missing.

    The page is complete without it, but its drawings are then static.
    """
    path = _script_file()
    if path is None:
        return ""
    # without a timestamp: the same run gives the same page
    return base64.b64encode(gzip.compress(path.read_bytes(), _LEVEL, mtime=0)).decode("ascii")


def plotly_notice() -> str:
    """Return version, copyright and licence of ``plotly.min.js`` in its own words, for the page; empty without it."""
    path = _script_file()
    if path is None:
        return ""
    with path.open("rb") as script:
        comment = _NOTICE.search(script.read(_NOTICE_BYTES).decode("utf-8", errors="replace"))
    lines = comment.group(1).split("\n") if comment is not None else []
    return "\n".join(line.strip(" *\r") for line in lines).strip()


def _script_file() -> Path | None:
    found = find_spec("plotly")
    for folder in (found.submodule_search_locations or ()) if found is not None else ():
        if (path := Path(folder) / _FILE).is_file():
            return path
    return None
