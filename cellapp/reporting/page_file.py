"""The file of an HTML page."""

from __future__ import annotations

import contextlib
from pathlib import Path

from cellapp.errors import InputError


def write_page_file(path: Path, text: str) -> Path:
    """Write a page and return its path; where that fails an earlier page stays whole.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror}); check disk and folder rights") from None
    return path
