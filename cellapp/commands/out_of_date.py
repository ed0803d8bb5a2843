"""Sentences on what is out of date in a run: stages, the page, and the certificate if written from older data.

``show``, ``report`` and the terminal application print these; with ``--strict`` they are an error.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.basis import basis_of
from cellapp.commands.stages import RunStages, read_history, read_stages
from cellapp.ground.results import CERTIFICATE

CERTIFICATE_FILE = "certificate.json"
"""Name of the certificate in the run's folder; ``--out`` writes it elsewhere."""
DATA_MARK = "cellapp-data"
"""Name of the page's ``meta`` element with the ``data_mark`` of the run when the page was written."""
_MARK = re.compile(rf'<meta name="{DATA_MARK}" content="([0-9a-f]{{64}})">')
_HEAD = 20_000
"""How many characters of the page are read to find its marks."""


def data_mark(run: RunFile, stages: RunStages | None = None) -> str:
    """Return the SHA-256 of all that a page of the run is made of: profile, readings, the newest stage of each name."""
    stages = stages or read_stages(run)
    parts = [basis_of(run).model_dump_json(), *(f"{name} {one.digest}" for name, one in stages.current.items())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def complaints_of(run: RunFile, stages: RunStages | None = None) -> list[str]:
    """Say what is out of date, one sentence each: readings, stages, the page, the certificate; empty if nothing is."""
    stages = stages or read_stages(run)
    outdated = [f"'{name}' is out of date ({reason})" for name, reason in stages.out_of_date.items()]
    removed = [f"arm '{arm}': {reason}" for arm, reason in run.removed_kinds().items()]
    return [*removed, *outdated, *_page_complaints(run, stages), *_certificate_complaints(run, stages)]


def complaints_in(folder: Path) -> list[str]:
    """Return ``complaints_of`` the run in a folder as it is now: ``--strict`` fails if there are any."""
    with RunFile.open(folder) as run:
        return complaints_of(run)


def _page_complaints(run: RunFile, stages: RunStages) -> list[str]:
    text = _text(run.folder / REPORT_FILE, _HEAD)
    if text is None:
        return []
    found = _MARK.search(text)
    if found is not None and found.group(1) == data_mark(run, stages):
        return []
    why = "an older version wrote it" if found is None else "the run has changed since"
    return [f"{REPORT_FILE} is out of date ({why}); run 'cellapp report {run.folder}'"]


def _certificate_complaints(run: RunFile, stages: RunStages) -> list[str]:
    """Say whether the certificate is not stored in the run, or certifies other data; ``stages`` has the newest one."""
    text, newest = _text(run.folder / CERTIFICATE_FILE), stages.current.get(CERTIFICATE)
    if text is None:
        return []
    if newest is None:
        return [f"{CERTIFICATE_FILE} is not of this run: it stores no certificate"]
    same = [one for one in read_history(run) if one.name == CERTIFICATE and _same_json(text, one.text)]
    if not same:
        return [f"{CERTIFICATE_FILE} is not a certificate that the run stores"]
    return [] if same[-1].basis == newest.basis else [f"{CERTIFICATE_FILE} is an earlier certificate, of other data"]


def _same_json(one: str, other: str) -> bool:
    try:
        return bool(json.loads(one) == json.loads(other))
    except ValueError:
        return False


def _text(path: Path, most: int = -1) -> str | None:
    """Read the first ``most`` characters of a file, all if negative; None if there is no file."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(most)
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError):
        return ""  # there is a file, but not the one that was written
