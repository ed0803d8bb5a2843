"""One ZIP file for a report to the authors: installed packages, profile, findings of the doctor, log of a run, some
states of each controller; no secrets, no keys, no readings."""

from __future__ import annotations

import io
import json
import os
import platform
import re
import time
import zipfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from cellapp.cell.driving.diagnosis import LONGEST_PROBE_S
from cellapp.cell.profile import profile_to_json
from cellapp.cell.run import RunFile
from cellapp.cell.run.file import rehearsals_path
from cellapp.commands.doctor.result import DoctorResult
from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.version import __version__
from drivers.settings import SettingError

_MOST_EVENTS = 1000
_MOST_OF_A_FILE = 1024 * 1024
"""Most bytes of a text file that are packed, taken from its end."""
_ERROR_LOG = Path("cellapp-error.log")


def bundle(path: Path, profile: Profile, result: DoctorResult, log: Mapping[str, str], seconds: float) -> bytes:
    """Build the ZIP file. ``log`` are the files of ``run_log``; ``seconds`` is the time that the doctor took."""
    secrets = _secrets(profile)
    timings: dict[str, float] = {"doctor_s": seconds}
    parts = {
        "versions.json": json.dumps(_versions(), indent=1),
        "doctor.json": result.to_json(indent=1),
        "profile.json": json.dumps(json.loads(profile_to_json(profile)), indent=1),
        "profile.yaml": _end_of(path),
    }
    for name, arm in profile.arms.items():
        began_s = time.monotonic()
        states = arm.driver.excerpt(LONGEST_PROBE_S)
        timings[f"excerpt {name}_s"] = time.monotonic() - began_s
        if states:
            parts[f"rtde-{name}.jsonl"] = "\n".join(json.dumps(state) for state in states) + "\n"
    parts |= {file.name: _end_of(file) for file in (rehearsals_path(path), _ERROR_LOG) if file.is_file()}
    parts |= log
    parts["timings.json"] = json.dumps(timings, indent=1)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in parts.items():
            file.writestr(name, redacted(text, secrets))
    return packed.getvalue()


def newest_run(profile: Profile) -> Path | None:
    """Return the folder of the newest run below ``logs`` of a profile with this name; None if there is none."""
    files = [(file.stat().st_mtime, file) for file in Path("logs").glob("*/run.sqlite")]
    for _, file in sorted(files, reverse=True):
        with suppress(CellappError), RunFile.open(file.parent) as run:
            if run.profile.name == profile.name:
                return file.parent
    return None


def _versions() -> dict[str, str]:
    found = {"cellapp": __version__, "python": platform.python_version(), "system": platform.platform()}
    with suppress(PackageNotFoundError):
        for requirement in requires("cellapp") or ():
            package = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
            with suppress(PackageNotFoundError):  # of an extra that is not installed
                found[package] = version(package)
    return found


def _secrets(profile: Profile) -> set[str]:
    """Collect the secrets of the profile and of environment variables with such names."""
    found = set[str]()
    with suppress(SettingError, OSError):
        found.add(profile.tracker.driver.token() or "")
    for name, value in os.environ.items():
        if any(word in name.upper() for word in ("TOKEN", "PASSWORD", "PASSPHRASE", "SECRET", "API_KEY")):
            found.add(value)
    return found - {""}


def _end_of(path: Path) -> str:
    try:
        return path.read_bytes()[-_MOST_OF_A_FILE:].decode("utf-8", "replace")
    except OSError as error:
        return f"{path.name} cannot be read: {error.strerror}\n"


def run_log(folder: Path | None) -> dict[str, str]:
    """Return the end of a run's log, and why stops were left out; empty without a run. Raises ``InputError``."""
    if folder is None:
        return {}
    if not (folder / "run.sqlite").is_file():
        raise InputError(f"--run {folder}: there is no run; give the folder of one, or leave it out")
    with RunFile.open(folder) as run:
        events = [f"{one.written} {one.level}: {one.text}" for one in run.events()[-_MOST_EVENTS:]]
        outcomes = [f"stop {one.stop + 1}: {one.reason}" for one in run.outcomes()]
    return {"run-log.txt": "\n".join(events) + "\n", "run-left-out.txt": "\n".join(outcomes) + "\n"}


# -- Removal of secrets from texts that leave the computer ------------------------------------------------------------


REDACTED = "[redacted]"
_PRIVATE = re.compile(r"-----BEGIN [A-Z ]*KEY-----.*?(?:-----END [A-Z ]*KEY-----|\Z)", re.DOTALL)
_USER = re.compile(r"(?<=//)[^/\s@\"']+:[^/\s@\"']*(?=@)")
_BEARER = re.compile(r"\b(Bearer|Basic)\s+[\w.~+/=-]{8,}", re.IGNORECASE)
_NAMED = re.compile(
    r"(?P<name>[\"']?\b[\w-]*(?:password|passwd|passphrase|secret|token|api[_-]?key|private[_-]?key|credential)[\w-]*"
    r"[\"']?\s*[:=]\s*)(?P<value>\"(?:[^\"\\]|\\.)*\"|'[^']*'|[^\s,}\]]+)",
    re.IGNORECASE,
)
_LEAST = 4
"""Least length of a secret that is searched for: shorter ones would be found in every number."""


def redacted(text: str, secrets: Collection[str] = ()) -> str:
    """Remove values of keys such as ``token`` or ``password``, PEM keys, users in addresses, ``secrets`` from texts."""
    for secret in sorted((one for one in secrets if len(one) >= _LEAST), key=len, reverse=True):
        text = text.replace(secret, REDACTED)
    text = _PRIVATE.sub(REDACTED, text)
    text = _USER.sub(REDACTED, text)
    text = _BEARER.sub(rf"\1 {REDACTED}", text)
    return _NAMED.sub(lambda found: f'{found["name"]}"{REDACTED}"', text)
