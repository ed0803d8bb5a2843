"""The file of an HTML page."""

from __future__ import annotations

from pathlib import Path

from cellapp.ground.outputs import RENEWED, Outputs


def write_page_file(path: Path, text: str, outputs: Outputs = RENEWED) -> Path:
    """Write a page and return its path; where that fails an earlier page stays whole.

    ``outputs`` says what may be replaced: left out, an earlier page.

    Raises
    ------
    InputError
        If it cannot be written, or may not.
    """
    outputs.write_text(path, text)
    return path
