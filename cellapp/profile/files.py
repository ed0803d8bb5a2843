"""Writing profiles: whole or not at all, and never over what a person wrote without a question."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

from cellapp.errors import InputError


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text as ``write_bytes`` does."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
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
        with part.open("wb") as file:
            file.write(data)
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
    """Write files of UTF-8 text as ``write_new_bytes`` does."""
    return write_new_bytes({path: text.encode("utf-8") for path, text in files.items()})


def write_new_bytes(files: dict[Path, bytes]) -> tuple[Path, ...]:
    """Write files that do not exist yet; return their paths. A file that has the same content is left as it is.

    Raises
    ------
    InputError
        If a file with other content exists, or one cannot be written. In the first case nothing was written.
    """
    for path, data in files.items():
        if path_exists(path) and _content_of(path) != data:
            raise InputError(
                f"{path} exists already; nothing was written. Give another name or folder, or move it away"
            )
    for path, data in files.items():
        if not path_exists(path):
            write_bytes(path, data)
    return tuple(files)


def path_exists(path: Path) -> bool:
    """Whether something is at ``path``. Raises ``InputError`` if the system cannot tell."""
    try:
        return path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be reached ({error.strerror}); give another folder") from None


def _content_of(path: Path) -> bytes | None:
    """The content of a file; None if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return None
