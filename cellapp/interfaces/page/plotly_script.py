"""Plotly's script for the page: found in the installed package, compressed, as text. Plotly itself is not imported."""

from __future__ import annotations

import base64
import gzip
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

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
