"""The secret token shared by the clients and the server of a tracker bridge."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from drivers.settings import SettingError

_SHORTEST = 16
_MOST_BYTES = 4096
"""Far longer than a token; limits the read if the path names a large file."""


def read_token(token_file: str | None, token_env: str | None) -> str | None:
    """Read the token from a file or an environment variable; None if neither is named.

    Raises
    ------
    SettingError
        If it is missing or too short, or other users may read the file. The message never contains the token.
    """
    if token_file is not None:
        return usable_token(_read_file(Path(token_file).expanduser()), str(token_file))
    if token_env is not None:
        text = os.environ.get(token_env)
        if text is None:
            raise SettingError(f"the environment variable {token_env} is not set; it should hold the bridge's token")
        return usable_token(text, f"the environment variable {token_env}")
    return None


def _read_file(path: Path) -> str:
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise SettingError(f"{path}: other users may read the bridge's token; run: chmod 600 {path}")
            return file.read(_MOST_BYTES).decode("utf-8")
    except OSError as error:
        raise SettingError(f"{path}: the bridge's token cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise SettingError(f"{path}: a binary file, not a token") from error


def usable_token(text: str, source: str = "") -> str:
    """Return the token in a text; raise ``SettingError``, with its ``source``, if too short or not printable ASCII."""
    token = text.strip()
    if len(token) < _SHORTEST or not token.isascii() or not token.isprintable():
        raise SettingError(
            f"{source}{': ' if source else ''}the bridge's token must be at least {_SHORTEST} printable ASCII"
            ' characters; make one with: python -c "import secrets; print(secrets.token_hex(32))"'
        )
    return token
