"""The Dockerfile, without Docker: a linter reads it, and the build gets what the wheel is made from."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "Dockerfile").read_text("utf-8")
WAIT_S = 60.0


def test_the_linter_finds_nothing() -> None:
    hadolint = shutil.which("hadolint")
    if hadolint is None:
        pytest.skip("hadolint has no wheel for this computer")
    done = subprocess.run(
        [hadolint, "Dockerfile"], cwd=ROOT, capture_output=True, text=True, timeout=WAIT_S, check=False
    )
    assert (done.returncode, done.stdout) == (0, "")


def test_the_build_gets_what_the_wheel_is_made_from() -> None:
    """What the Dockerfile copies, and what .dockerignore lets through, is what pyproject.toml names."""
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wheel = whole["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {"pyproject.toml", whole["project"]["readme"], *whole["project"]["license-files"]}
    needed |= {*wheel["packages"], *wheel["force-include"]}
    copied = {word for line in re.findall(r"^COPY (.*) \S+$", TEXT, re.MULTILINE) for word in line.split()}
    ignored, *admitted = re.findall(r"^[^#\n]+$", (ROOT / ".dockerignore").read_text("utf-8"), re.MULTILINE)
    assert copied == needed
    assert ignored == "*"
    assert {line[1:] for line in admitted if line.startswith("!")} == needed


def test_the_program_is_not_root_and_the_base_is_pinned() -> None:
    (*_, last) = re.findall(r"^USER (\S+)$", TEXT, re.MULTILINE)
    assert int(last) > 0
    bases = set(re.findall(r"^FROM (\S+)", TEXT, re.MULTILINE))
    assert len(bases) == 1
    assert re.fullmatch(r"python:3\.1[12]\.\d+-slim-\w+", *bases)
    assert "EXPOSE" not in TEXT  # servers stay on loopback
