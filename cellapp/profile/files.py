"""Writing profiles: whole or not at all, and never over what a person wrote without a question."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

from cellapp.errors import InputError


def write_text(path: Path, text: str) -> None:
    """Write a file through a temporary one beside it, so that a full disk leaves the old file whole.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = path.resolve()  # a link stays a link
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, part)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); give a folder that you may write to and that has space"
        ) from None


def write_new(files: dict[Path, str]) -> tuple[Path, ...]:
    """Write files that do not exist yet; return their paths. A file that has the same text already is left as it is.

    Raises
    ------
    InputError
        If a file with another text exists, or one cannot be written. In the first case nothing was written.
    """
    for path, text in files.items():
        if path_exists(path) and _text_of(path) != text:
            raise InputError(
                f"{path} exists already; nothing was written. Give another name or folder, or move it away"
            )
    for path, text in files.items():
        if not path_exists(path):
            write_text(path, text)
    return tuple(files)


def path_exists(path: Path) -> bool:
    """Whether something is at ``path``. Raises ``InputError`` if the system cannot tell."""
    try:
        return path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be reached ({error.strerror}); give another folder") from None


def _text_of(path: Path) -> str | None:
    """The text of a file; None if it cannot be read as text."""
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return None
