"""Text of a file that a person named."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellapp.ground.errors import InputError


@contextmanager
def readable(path: Path | str, advice: str) -> Iterator[None]:
    """Raise ``InputError`` with an ``advice`` if a file that is opened in this context cannot be read."""
    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: file not found; {advice}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {advice}") from None


def file_text(path: Path, advice: str) -> str:
    """Return the text of a file. Raise ``InputError`` with an ``advice`` if it cannot be read, or is not UTF-8."""
    with readable(path, advice):
        raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: not UTF-8 text ({error.reason}); save the file as UTF-8") from None
