"""Environments of the peers: one folder each, filled by plain pip."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

_INSTALL_S = 900.0
"""Time for an installation: figaroh and its dependencies are some 300 MB."""
_LONGEST_REASON = 160
"""Characters of a reason in the table."""


class Failed(Exception):
    """A peer could not be installed, or gave no answer; the message is the reason in one line."""


def python_of(requirement: str, venvs: Path) -> Path:
    """Interpreter of the environment in which a requirement (``name==version``) is installed, made if it is not there.

    Raises
    ------
    Failed
        With the last line of what venv or pip said.
    """
    folder = venvs.resolve() / requirement.partition("==")[0]
    python, installed = folder / "bin" / "python", folder / "installed.txt"
    if os.name == "nt":
        python = folder / "Scripts" / "python.exe"
    if not installed.is_file() or installed.read_text(encoding="utf-8") != requirement:
        run([sys.executable, "-m", "venv", "--clear", str(folder)], _INSTALL_S)
        run([str(python), "-m", "pip", "install", "--disable-pip-version-check", requirement], _INSTALL_S)
        installed.write_text(requirement, encoding="utf-8")
    return python


def run(command: list[str], timeout_s: float) -> None:
    """Run a command on one thread of linear algebra.

    Raises
    ------
    Failed
        If it ends with an error or not in time.
    """
    one_thread = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    try:
        done = subprocess.run(
            command, env=os.environ | one_thread, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        raise Failed(f"no answer after {timeout_s:g} s") from None
    except OSError as error:
        raise Failed(str(error)) from None
    if done.returncode:
        lines = (done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}").splitlines()
        errors = [line for line in lines if line.startswith("ERROR")]  # pip's reason, before its hints
        raise Failed((errors or lines)[-1][:_LONGEST_REASON])
