"""Words of commands that people copy."""

from __future__ import annotations

import re
from pathlib import Path


def shell_word(text: str | Path) -> str:
    """Return a text as one word of a command line; in double quotes if a shell would take it apart."""
    plain = str(text)
    if re.fullmatch(r"[\w@%+=:,./~-]+", plain):
        return plain
    return '"' + re.sub(r'([$`"\\])', r"\\\1", plain) + '"'
