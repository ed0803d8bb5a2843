"""What the most used verbs load when they start: no part of scipy before it is used, no search for a mere look."""

from __future__ import annotations

import subprocess
import sys

LOADED = """
import sys
import cellapp.interfaces.cli.app, cellapp.commands.doctor.run
searches = [name for name in sys.modules if name.startswith("cellapp.estimation.discovery.search")]
assert not searches, f"doctor: {searches}"
from importlib import import_module
for verb in ("plan", "calibrate", "report", "show", "check"):
    import_module(f"cellapp.commands.{verb}.run")
    parts = [name for name in sys.modules if name.startswith("scipy.") and not name.startswith("scipy._")]
    assert set(parts) <= {"scipy.__config__", "scipy.version"}, f"{verb}: {parts}"
"""


def test_verbs_start_without_scipy_and_doctor_without_the_search() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
