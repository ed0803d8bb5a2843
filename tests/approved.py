"""Views that were approved as text: one file a view and state, compared whole.

After a view was changed on purpose, write the texts anew, then read the difference in git:

    CELLAPP_UPDATE_SNAPSHOTS=1 python -m pytest FILE
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Facts, Parts, Section
from cellapp.commands.view.table import Table
from cellapp.ground.errors import CellappError

_HASH = re.compile(r"\b(?=[a-f]*\d)[0-9a-f]{8,64}\b")
UPDATE = os.environ.get("CELLAPP_UPDATE_SNAPSHOTS", "") not in ("", "0")


def differences(path: Path, shown: str, words_of: Callable[[str], str] = str) -> list[str]:
    """Unified difference of a text's words from what is kept; with the variable set, it is kept instead."""
    if UPDATE:
        path.parent.mkdir(exist_ok=True)
        path.write_text(shown.rstrip("\n") + "\n", encoding="utf-8", newline="\n")
        return []
    kept = path.read_text("utf-8") if path.is_file() else ""
    before, now = (words_of(_HASH.sub("HASH", text.rstrip("\n"))).splitlines() for text in (kept, shown))
    return list(difflib.unified_diff(before, now, f"kept {path.name}", f"now {path.name}", lineterm=""))


def assert_approved(path: Path, shown: str, words_of: Callable[[str], str] = str) -> None:
    """Fail with the difference from the text that was approved."""
    found = differences(path, shown, words_of)
    assert not found, "\n".join([*found, "if this was wanted, write it anew as tests/approved.py says"])


def without_digits(text: str) -> str:
    """A text without what depends on the processor and the day: numbers, whole words of numbers' ranges."""
    return re.sub(r"[-+−]?\d[\d.:]*(e[-+]?\d+)?", "0", text)


def text_of(parts: Parts, depth: int = 0) -> str:
    """All that parts of a view say: sentences, facts, tables, and of charts titles, axes, series, limits, message."""
    return "\n".join("  " * depth + line for part in parts for line in _lines(part))


def _lines(part: object) -> Iterator[str]:
    if isinstance(part, Section):
        notes = [
            word for word, holds in (("folded", part.folded), (f"OUTDATED {part.outdated}", part.outdated)) if holds
        ]
        yield " ".join([f"# {part.title}", *([f"[{part.key}]"] if part.key else []), *notes])
        yield from (f"  {text}" for text in (part.message, part.about) if text)
        yield from text_of(part.parts, 1).splitlines()
    elif isinstance(part, Facts):
        yield from (f"{title}: {text}" for title, text in part.rows)
    elif isinstance(part, Table):
        yield f"table {part.title}"
        yield from (f"  {' | '.join(row)}" for row in (part.headings, *part.text_rows()))
    elif isinstance(part, Chart):
        yield f"chart {part.title}: {part.y.label} [{part.y.unit}] over {part.x.label} [{part.x.unit}]"
        for one in part.series:
            ends = "" if not len(one.y) else f", {np.nanmin(one.y):.3g} to {np.nanmax(one.y):.3g}"
            yield f"  {one.kind} {one.name}: {len(one.y)}{ends}{', band' if one.band is not None else ''}"
        yield from (f"  limit {one.name}: {one.value:.4g}" for one in part.limits)
        yield f"  {part.message}"
    else:
        yield str(part)


def assert_refused(path: Path, refusal: Callable[..., object], *folders: Path) -> None:
    """Compare what is said of each line ``$ WORD ...`` of a text, in whose words a line end stands as ``\\n``.

    ``refusal`` gets the words and returns what is said, or raises it as an error of cellapp or a ValueError; paths
    in ``folders`` are said from there on.
    """
    shown = []
    for command in commands_of(path):
        try:
            said = refusal(*(word.replace("\\n", "\n") for word in shlex.split(command)))
            assert isinstance(said, str), f"not refused: {command}"
        except (CellappError, ValueError) as error:
            said = str(error)
        for folder in folders:
            said = said.replace(f"{folder}/", "")
        shown += [f"$ {command}", said]
    assert_approved(path, "\n".join(shown))


def commands_of(path: Path) -> list[str]:
    """The commands of a transcript: lines that begin with ``$``; what stands below each is what was approved."""
    return [line[2:] for line in path.read_text("utf-8").splitlines() if line.startswith("$ ")]
