"""The shared token of a tracker bridge, from where the profile says it is."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from cellapp.errors import InputError
from drivers.trackers.bridge_server import usable_token

_LONGEST_BYTES = 4096


def read_token(token_file: str | None, token_env: str | None) -> str | None:
    """The token in a file or an environment variable; None where neither is named.

    Raises
    ------
    InputError
        If there is none, it is too short, or others may read the file. The token itself is never told.
    """
    if token_file is not None:
        return _usable(_from_file(Path(token_file).expanduser()), str(token_file))
    if token_env is not None:
        text = os.environ.get(token_env)
        if text is None:
            raise InputError(f"the environment variable {token_env} is not set; it should hold the bridge's token")
        return _usable(text, f"the environment variable {token_env}")
    return None


def _from_file(path: Path) -> str:
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise InputError(f"{path}: others may read the bridge's token; run: chmod 600 {path}")
            return file.read(_LONGEST_BYTES).decode("utf-8")
    except OSError as error:
        raise InputError(f"{path}: the bridge's token cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: this is no token but some binary file") from error


def _usable(text: str, where: str) -> str:
    try:
        return usable_token(text)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
