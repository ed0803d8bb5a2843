"""Writing of profiles: completely or not at all, and never over a person's file without asking.

The calibration file of a UR controller: the section ``[mounting]`` of its ``calibration.conf``.

``cellapp export --as ur-calibration`` writes such a file for a controller, ``doctor --controllers`` the one it has.
"""

from __future__ import annotations

import configparser
import math
from collections.abc import Sequence
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


_SECTION = "mounting"
_LISTS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
_CHECKSUMS = "joint_checksum"
_DIGITS = 18
"""Significant digits, as the controller writes them; 17 make a double exact. Of 200 UR10 sampled at 0.3 mm and 0.05
degrees, nine digits lose 0.5 um in the median and 8 um at most, twelve 0.01 um at most."""


def controller_table(text: str, path: Path) -> dict[str, object]:
    """Return the values of a profile's section ``factory`` from a ``calibration.conf``, ignoring its other keys.

    Raises
    ------
    InputError
        If it is no such file, or a list is missing or holds anything but numbers.
    """
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(text, str(path))
    except configparser.Error:
        raise InputError(f"{path}: no calibration.conf: expected a section [{_SECTION}] and lines KEY = LIST") from None
    if not parser.has_section(_SECTION):
        raise InputError(f"{path}: no section [{_SECTION}]; give the calibration.conf of the arm's controller")
    section = parser[_SECTION]
    found: dict[str, object] = {name: _numbers(section.get(name), name, path) for name in _LISTS}
    words = [word.strip() for word in section.get(_CHECKSUMS, "").strip("[] ").split(",") if word.strip()]
    try:
        found["checksum"] = "-".join(f"{int(word, 0):08x}" for word in words)
    except ValueError:
        raise InputError(f"{path}: {_CHECKSUMS}: expected numbers such as 0x1a2b3c4d") from None
    return found


def controller_file_text(deltas: Sequence[Sequence[float]], checksum: str, comment: Sequence[str] = ()) -> str:
    """Compose a ``calibration.conf`` from rows of deltas of theta, d, a, alpha [rad, m], one row per joint."""
    columns = dict(zip(("delta_theta", "delta_d", "delta_a", "delta_alpha"), zip(*deltas, strict=True), strict=True))
    lines = [f"# {line}" for line in comment] + [f"[{_SECTION}]"]
    lines += [f"{name} = [ {', '.join(f'{value:.{_DIGITS}g}' for value in columns[name])}]" for name in _LISTS]
    if checksum:
        lines.append(f"{_CHECKSUMS} = [ {', '.join(f'0x{word}' for word in checksum.split('-'))}]")
    return "\n".join(lines) + "\n"


def _numbers(text: str | None, name: str, path: Path) -> list[float]:
    if text is None:
        raise InputError(f"{path}: [{_SECTION}] has no {name}; give the calibration.conf of the arm's controller")
    try:
        numbers = [float(word) for word in text.strip().removeprefix("[").removesuffix("]").split(",")]
    except ValueError:
        raise InputError(f"{path}: {name}: expected numbers between commas, as [ 0.0012, -0.0003]") from None
    if not all(map(math.isfinite, numbers)):
        raise InputError(f"{path}: {name}: a value is not a finite number")
    return numbers
