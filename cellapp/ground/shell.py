"""Words of commands that people copy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path


def shell_word(text: str | Path) -> str:
    """Return a text as one word of a command line; in double quotes if a shell would take it apart."""
    plain = str(text)
    if re.fullmatch(r"[\w@%+=:,./~-]+", plain):
        return plain
    return '"' + re.sub(r'([$`"\\])', r"\\\1", plain) + '"'


def filled(text: str, files: Mapping[str, Path]) -> str:
    """Put ``files`` in the place of words, as DIR and PROFILE, of the commands that a text quotes."""

    def file(match: re.Match[str]) -> str:
        return shell_word(files[match[0]]) if match[0] in files else match[0]

    return re.sub(r"'cellapp [^']+'", lambda command: re.sub(r"\b[A-Z]+\b", file, command[0]), text)
