"""Writing of profiles: completely or not at all, and never over a person's file without asking."""

from __future__ import annotations

from pathlib import Path

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, written_beside


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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_beside(path, replace=True) as file:
            file.write(data)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); give a folder that you may write to and that has space"
        ) from None


def write_new(files: dict[Path, str], outputs: Outputs = NEW_ONLY) -> tuple[Path, ...]:
    """Write files of UTF-8 text as ``write_new_bytes`` does."""
    return write_new_bytes({path: text.encode("utf-8") for path, text in files.items()}, outputs)


def write_new_bytes(files: dict[Path, bytes], outputs: Outputs = NEW_ONLY) -> tuple[Path, ...]:
    """Write files and their missing folders; return their paths. A file with the same content is left as it is.

    Raises
    ------
    InputError
        If a file must not be written, as one with other content exists (nothing was written then), or cannot be.
    """
    changed = {path: data for path, data in files.items() if not path_exists(path) or _content_of(path) != data}
    for path in changed:
        outputs.check_file(path)
    for path, data in changed.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); give a folder that you may write to"
            ) from None
        outputs.write(path, data)
    return tuple(files)


def path_exists(path: Path) -> bool:
    """Return whether something is at ``path``. Raise ``InputError`` if the system cannot tell."""
    try:
        return path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be reached ({error.strerror}); give another folder") from None


def _content_of(path: Path) -> bytes | None:
    """Return the content of a file; None if it cannot be read, or is not a regular file."""
    try:
        if not path.is_file():
            return None
        return path.read_bytes()
    except OSError:
        return None
