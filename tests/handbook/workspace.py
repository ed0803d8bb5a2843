"""A folder in which the commands of a chapter run: small profiles, finished runs, programs to correct."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import typer
import yaml
from typer.testing import CliRunner

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import CheckFailed
from tests.commands.measured_runs import measured_run, set_month
from tests.commands.moved_arms import add_arm, true_arm, write_recording
from tests.handbook.chapters import ROOT, Command, Example
from tests.handbook.doors import merged
from tests.program import app
from tests.twin import PROFILES, make_small, small_twin, write_profile

LONGEST_S = 300.0
COLUMNS = "110"
"""Width of the terminal in which the chapters' commands print."""
RUN = "logs/my-run"
PLACEHOLDERS: Mapping[str, str] = {
    "DIR": RUN,
    "NEW": "logs/new",
    "PROFILE": "profiles/twin.yaml",
    "TARGETS": "profiles/targets/twin.yaml",
    "N": "2",
    "X": "2",
    "PORT": "50960",
    "LIST": "0-1",
    "FORMAT": "urdf",
    "PART": "plan",
    "TOPIC": "check",
    "NAME": "twin",
}
"""Words of the chapters in capitals that stand for something, and what the tests put there; ``NEW`` gets a number."""
PYTHON_NAMES: Mapping[str, object] = {"q": np.zeros((3, 6))}
"""Names that python examples use without making them."""
_NEEDS_A_SHELL = re.compile(r"[|<>;$*`]|&[^&]|&$")
_MAKES_A_RUN = frozenset({"plan", "import", "run"})
"""Verbs whose ``--run`` names a run that is not there yet, ..."""
_CHANGES_A_RUN = frozenset({"--edit"})
"""... but with this option names one that is."""
_QUOTED = re.compile(r"[\"']([^\"'\n]+)[\"']")
_INSTALLS = re.compile(r"\b(pip|pipx|docker|podman|apt|apt-get|git|pytest|ruff|mypy|conda|uv)\b")


@dataclass(frozen=True)
class Workspace:
    """A folder with a chapter's commands, and the run that commands find as finished."""

    folder: Path
    finished: Path
    full_size: bool
    printed: list[str] = field(default_factory=list)
    """What the commands of this program printed, one after the other."""

    def prepare(self, examples: Sequence[Example]) -> None:
        """Write the blocks to which the chapter gives a file's name."""
        (self.folder / "tests").mkdir()
        (self.folder / "tests" / "fixtures").symlink_to(ROOT / "tests" / "fixtures", target_is_directory=True)
        (self.folder / "logs").mkdir()
        for example in examples:
            if name := example.value("file"):
                path = self.folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(self._file_text(example), encoding="utf-8")

    def _file_text(self, example: Example) -> str:
        if not example.value("part"):
            return example.text
        content = merged(example, PROFILES)
        for arm in content["arms"].values():
            arm["type"] = str(PROFILES / arm["type"])
        return yaml.safe_dump(content)

    def run(self, command: Command) -> str:
        """Run a line; return what is wrong, empty if nothing. That a check did not hold (exit code 1) is not wrong."""
        words = self.words(command.text)
        self._make_what_is_named(words)
        if _NEEDS_A_SHELL.search(command.text) or not _is_ours(words):
            return self._run_in_shell(shlex.join(words) if not _NEEDS_A_SHELL.search(command.text) else command.text)
        for part in _parts(words):
            if wrong := self._run_here(part):
                return wrong
        return ""

    def words(self, line: str) -> list[str]:
        """Words of a line, with what the tests put for placeholders."""
        new = len(list((self.folder / "logs").iterdir()))
        return [
            f"{PLACEHOLDERS[word]}-{new}" if word == "NEW" else PLACEHOLDERS.get(word, word)
            for word in shlex.split(line, comments=True)
        ]

    def _run_here(self, words: Sequence[str]) -> str:
        if not _is_ours(words):
            return self._run_in_shell(shlex.join(words))
        ended = CliRunner().invoke(app, words[1:], env={"COLUMNS": COLUMNS})
        self.printed.append(ended.output)
        if words[1:2] == ["init"] and not self.full_size:
            for path in self.folder.glob("**/profiles/twin.yaml"):
                make_small(path)
                _make_quick(path)
        if ended.exit_code == 0 or isinstance(ended.exception, CheckFailed):
            return ""
        return f"{ended.exception!r} {ended.output[-500:]}"

    def _run_in_shell(self, line: str) -> str:
        if found := _INSTALLS.search(line):
            return f"'{found[0]}' is not run by tests; begin the block with ```sh dev"
        (self.folder / "bin").mkdir(exist_ok=True)
        program = self.folder / "bin" / "cellapp"
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cellapp "$@"\n')
        program.chmod(0o755)
        path = os.pathsep.join([str(program.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", line],
            cwd=self.folder,
            env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )
        return "" if done.returncode == 0 else f"exit code {done.returncode}: {(done.stderr or done.stdout)[-500:]}"

    def _make_what_is_named(self, words: Sequence[str]) -> None:
        """Make files and runs that a line names, that no command makes and no block holds."""
        for before, word in zip(["", *words], words):
            if before == "--run" and _MAKES_A_RUN & set(words) and not _CHANGES_A_RUN & set(words):
                continue
            for name, make in MADE.items():
                path = self.folder / name
                named = word == name or (word.startswith(f"{name}/") and name != "logs")
                if named and (not path.exists() or (path.is_dir() and not any(path.iterdir()))):
                    make(self, path)

    def python_problem(self, example: Example, names: dict[str, object]) -> str:
        """Execute a block, with the ``names`` of the blocks before it; return what is wrong, with its line."""
        self._make_what_is_named(_QUOTED.findall(example.text))
        source = "\n" * (example.line - 1) + example.text
        try:
            exec(compile(source, str(example.path), "exec"), names)
        except Exception as error:  # noqa: BLE001 - an example may raise anything
            trace = error.__traceback__
            while trace is not None and trace.tb_frame.f_code.co_filename != str(example.path):
                trace = trace.tb_next
            return f"line {example.line if trace is None else trace.tb_lineno}: {error!r}"
        return ""


def _is_ours(words: Sequence[str]) -> bool:
    """Whether a command line is one of this program."""
    return words[:1] == ["cellapp"]


def _make_quick(path: Path) -> None:
    """Let the stops of the twin's profile be drawn, not designed, and have it verified at four targets."""
    text = path.read_text("utf-8")
    path.write_text(text.replace("stops: 30", "stops: 30\n  method: random"), "utf-8")
    targets = path.parent / "targets" / "twin.yaml"
    lines = targets.read_text("utf-8").splitlines()
    few = [line for line in lines if "name:" not in line or "-01," in line or "-02," in line]
    targets.write_text("\n".join(few), "utf-8")


def _parts(words: Sequence[str]) -> Iterator[list[str]]:
    """The commands of a line that ``&&`` joins."""
    part: list[str] = []
    for word in [*words, "&&"]:
        if word == "&&":
            yield part
            part = []
        else:
            part.append(word)


# -- what a chapter names without making it ---------------------------------------------------------------------------


def _profiles(space: Workspace, path: Path) -> None:
    """The profiles that come with the program, that of the twin made small."""
    if space.full_size:
        shutil.copytree(PROFILES, path)
    else:
        _make_quick(write_profile(path))


def _copy_run(space: Workspace, path: Path) -> None:
    shutil.copytree(space.finished, path, dirs_exist_ok=True)


def _earlier_run(_: Workspace, path: Path) -> None:
    """The same arms, measured at other stops."""
    with new_planned_run(small_twin(60, plan={"method": "random"}), path) as run:
        collect_run(run)
        calibrate_run(run)


def _months(_: Workspace, path: Path) -> None:
    """Three runs of one cell, a month apart."""
    folder = path if path.name == "logs" else path.parent
    for month, name in enumerate(("january", "february", "march")):
        if not (folder / name).exists():
            set_month(measured_run(folder / name, month), month)


def _program(text: str) -> Callable[[Workspace, Path], None]:
    """Write a program with the joint positions of a stop in the place of ``Q``."""

    def write(space: Workspace, path: Path) -> None:
        with RunFile.open(space.finished) as run:
            q = run.readings("left").q[5].tolist()
        whole = text.replace("Q", str(q)[1:-1]).encode()
        path.write_bytes(gzip.compress(whole) if path.suffix == ".urp" else whole)

    return write


def _few_stops(space: Workspace, path: Path) -> None:
    """The first two stops of the plan that the chapter exported before."""
    rows = (space.folder / "plan.csv").read_text("utf-8").splitlines(keepends=True)
    path.write_text("".join([rows[0], *(row for row in rows if row[:2] in ("0,", "1,"))]), "utf-8")


def _recording(space: Workspace, path: Path) -> None:
    """Files of joints and points of one arm of the twin, which name the arm."""
    arm = path.name.partition("_")[0]
    profile = load_profile(PROFILES / "twin.yaml")
    for file in write_recording(space.folder, arm, true_arm(profile, arm)):
        add_arm(file, arm)


MADE: Mapping[str, Callable[[Workspace, Path], None]] = {
    "profiles": _profiles,
    RUN: _copy_run,
    "logs/last-year": _earlier_run,
    "logs": _months,
    "logs/january": _months,
    "few.csv": _few_stops,
    "left_joints.csv": _recording,
    "right_joints.csv": _recording,
    "day.script": _program("set_tcp(p[0,0,0.1,0,0,0])\nmovej([Q])\n"),
    "loops.script": _program("movej([Q])\nmovel(pose_add(get_actual_tcp_pose(), p[0,0,0.1,0,0,0]))\n"),
    "bare.script": _program("movej([Q])\n"),
    "taught.urp": _program(
        '<URProgram><Waypoint type="Fixed" name="a"><position><JointAngles angles="Q"/>'
        "</position></Waypoint></URProgram>"
    ),
}
"""Files and runs that chapters name, and what makes them for the tests."""


# -- commands that are not run ----------------------------------------------------------------------------------------


def not_printed(text: str, printed: str) -> str:
    """The first line of a text that was not printed; empty if there is none. Dots stand for what is left out."""
    flat = " ".join(printed.split())
    for line in text.splitlines():
        if any(" ".join(part.split()) not in flat for part in line.split("...")):
            return f"not printed: {line.strip()}"
    return ""


def not_understood(line: str, *, whole: bool) -> str:
    """What is wrong with the commands of this program in a line, by their options alone; empty if nothing.

    With ``whole`` false a command may lack arguments, and brackets and dots are left out: it stands in a sentence.
    """
    if not whole:
        line = re.sub(r"[\[\]]|\.\.\.", " ", line)
    try:
        words = shlex.split(line.replace(";", " && ").replace("|", " && "), comments=True)
    except ValueError as error:
        return str(error)
    for part in filter(_is_ours, _parts([PLACEHOLDERS.get(word, word) for word in words])):
        try:
            with contextlib.suppress(typer.Exit), contextlib.redirect_stdout(io.StringIO()):  # of ``--help``
                _parse(_whole_command(), part[0], part[1:], None)
        except ImportError as error:
            return str(error)
        except typer.TyperException as error:
            if whole or type(error).__name__ not in ("MissingParameter", "NoArgsIsHelpError", "BadOptionUsage"):
                return str(error)
    return ""


@cache
def _whole_command() -> Any:
    return typer.main.get_command(app)


def _parse(command: Any, name: str | None, words: list[str], parent: Any) -> None:
    """Parse the words of a command and of the commands below it, and call none.

    An option that acts while words are parsed, as ``--help`` or the one that installs completion, is left out.
    """
    acting = {name for one in command.params if one.is_eager or one.callback for name in one.opts}
    if acting.intersection(words):
        return
    with command.make_context(name, words, parent=parent) as context:
        if rest := [*getattr(context, "_protected_args", ()), *context.args]:
            below_name, below, below_words = command.resolve_command(context, rest)
            _parse(below, below_name, below_words, context)
