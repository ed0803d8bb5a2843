"""Printing a page through an installed Chromium, in a process of its own with an empty profile."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED, Outputs

_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome-stable",
    "google-chrome",
    "chrome",
    "microsoft-edge",
    "brave-browser",
)
"""Names under which systems install a Chromium, or a browser that takes the same options."""
_LONGEST_S = 120.0
"""A page of 5 MB prints in a few seconds; a browser that takes this long hangs."""
_FLAGS = (
    "--headless",
    "--disable-gpu",
    "--disable-extensions",
    "--disable-background-networking",
    "--no-first-run",
    "--no-default-browser-check",
    "--no-pdf-header-footer",
)


def find_chromium() -> Path:
    """Path of an installed Chromium.

    Raises
    ------
    InputError
        If none of the usual names is on the search path.
    """
    for name in _NAMES:
        path = shutil.which(name)
        if path is not None:
            return Path(path)
    raise InputError(
        f"no Chromium is installed here (looked for {', '.join(_NAMES)}); install one, as Debian's package chromium,"
        " or open the page in any browser and print it there"
    )


def print_pdf(page: Path, out: Path, timeout_s: float = _LONGEST_S, outputs: Outputs = RENEWED) -> None:
    """Print an HTML file to a PDF file, with the sizes and breaks of the page's own style sheet.

    ``outputs`` says what may be replaced: left out, an earlier print.

    Raises
    ------
    InputError
        If there is no Chromium, it fails or does not end in time, or the file cannot be written.
    """
    browser = find_chromium()
    with tempfile.TemporaryDirectory(prefix="cellapp-print-", ignore_cleanup_errors=True) as folder:
        printed = Path(folder) / "page.pdf"
        command = [str(browser), *_FLAGS, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox refuses to work for root
        words = _run([*command, page.absolute().as_uri()], timeout_s)
        if not printed.is_file():
            raise InputError(
                f"{browser} printed nothing ({words or 'no message'}); open {page} in a browser, print there"
            )
        with outputs.open(out) as file:
            file.write(printed.read_bytes())


def _run(command: list[str], timeout_s: float) -> str:
    """Run a browser to its end, with all processes that it starts; the last line that it wrote."""
    started = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        _, words = started.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        raise InputError(
            f"{command[0]} did not print within {timeout_s:g} s and was ended; try again or print it in a browser"
        ) from None
    finally:
        if started.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(started.pid, signal.SIGKILL)
            started.communicate()
    lines = words.strip().splitlines()
    return lines[-1] if lines else ""
