"""The calibration file of a UR controller: the section ``[mounting]`` of its ``calibration.conf``.

``cellapp export --as ur-calibration`` writes such a file for a controller, ``doctor --controllers`` the one it has.
"""

from __future__ import annotations

import configparser
import math
from collections.abc import Sequence
from pathlib import Path

from cellapp.ground.errors import InputError

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
