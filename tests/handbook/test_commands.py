"""Every command and every example of README and handbook: read by the program, and run where that takes seconds.

Slow tests run those marked ``long``, too, with full profiles.
How to mark a block: ``tests/handbook/chapters.py``. What placeholders stand for, and files that chapters only name:
``tests/handbook/workspace.py``.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.handbook.chapters import (
    CHAPTERS,
    EXCERPT,
    LONG,
    NOT_RUN,
    PRINTED,
    ROOT,
    Command,
    Example,
    commands,
    examples,
    mentions,
)
from tests.handbook.doors import read_example
from tests.handbook.workspace import PYTHON_NAMES, Workspace, not_printed, not_understood
from tests.twin import write_profile

RUN_BY_CI = 2
"""The first commands of the README install the program: ``.ci/run`` runs them in a fresh environment."""
WORDS = {"sh": {LONG, *NOT_RUN}, "python": {LONG, *NOT_RUN}, "yaml": {EXCERPT}, "csv": {EXCERPT}, "text": {PRINTED}}
KEYS = {"file", "part"}


def is_run(chapter: str, example: Example, *, long: bool) -> bool:
    """Whether the tests run a block, or only read it."""
    if example.language not in ("sh", "python") or example.words & set(NOT_RUN):
        return False
    if chapter == "README" and example in [one for one in examples(chapter) if one.language == "sh"][:RUN_BY_CI]:
        return False
    return long or LONG not in example.words


_SLOW = (pytest.mark.slow, pytest.mark.minutes, pytest.mark.timeout(1800))
CHAPTERS_RUN = [
    *(
        pytest.param(chapter, False, id=chapter)
        for chapter in CHAPTERS
        if any(is_run(chapter, example, long=False) for example in examples(chapter))
    ),
    *(
        pytest.param(chapter, True, id=f"{chapter}, long", marks=_SLOW)
        for chapter in CHAPTERS
        if any(example.words & {LONG, PRINTED} for example in examples(chapter))
    ),
]
"""Chapter, and whether its long commands run as well and what they print is compared, on full profiles."""


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_every_command_and_example_is_understood(
    chapter: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    profiles = write_profile(tmp_path / "profiles").parent
    wrong = [problem for example in examples(chapter) for problem in _problems(example, profiles)]
    for mention in mentions(chapter):
        wrong += _told(mention.place, mention.text, not_understood(mention.text, whole=False))
    blocks = [example for example in examples(chapter) if example.language not in ("", "text", "sh")]
    record_property("documented examples read", len(blocks))
    record_property("documented commands in sentences parsed", len(mentions(chapter)))
    assert not wrong, "\n".join(["", *wrong])


def _problems(example: Example, profiles: Path) -> Iterator[str]:
    """What is wrong with a block that can be found without running it."""
    unknown = {key for key, _ in example.values} - KEYS | example.words - WORDS.get(example.language, set())
    if unknown:
        known = sorted(WORDS.get(example.language, set())) + [f"{key}=" for key in sorted(KEYS)]
        yield f"{example.place(-1)}: ```{example.language}: unknown {sorted(unknown)}; known are {', '.join(known)}"
    try:
        read_example(example, profiles)
    except Exception as error:  # noqa: BLE001 - whatever the door says is told with the place of the example
        yield f"{example.place()}: ```{example.language}: {error}; correct the example"
    if example.language == "sh":
        checked = subprocess.run(["bash", "-n"], input=example.text, capture_output=True, text=True)
        yield from _told(example.place(), "the whole block", checked.stderr)
        for command in commands(example):
            yield from _told(command.place, command.text, not_understood(command.text, whole=True))
            for word in command.text.split():
                if word.startswith("tests/") and not (ROOT / word.split("::")[0]).exists():
                    yield from _told(command.place, command.text, f"{word} does not exist")


@pytest.mark.slow
@pytest.mark.parametrize(("chapter", "long"), CHAPTERS_RUN)
def test_commands_and_python_run(
    chapter: str,
    long: bool,
    finished_run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Callable[[str, object], None],
) -> None:
    space = Workspace(tmp_path, finished_run, full_size=long)
    space.prepare(examples(chapter))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))  # no command changes what is a person's own
    wrong, names, count = list[str](), dict(PYTHON_NAMES), {"run": 0, "only parsed": 0}
    for example in examples(chapter):
        run = is_run(chapter, example, long=long)
        if example.language == "python" and run:
            wrong += _told(example.place(), "```python", space.python_problem(example, names))
        for command in commands(example) if example.language == "sh" else ():
            count["run" if run else "only parsed"] += 1
            wrong += _told(command.place, command.text, space.run(command)) if run else []
        if PRINTED in example.words and long:
            wrong += _told(example.place(), "```text printed", not_printed(example.text, "".join(space.printed)))
    for how, number in count.items():
        record_property(f"documented commands {how}", number)
    assert not wrong, "\n".join(["", *wrong])


def _told(place: str, text: str, problem: str) -> list[str]:
    """The problem with its place and what to do about it; empty if there is none."""
    if not problem:
        return []
    advice = (
        "correct it, mark its block (tests/handbook/chapters.py), or say what it needs (tests/handbook/workspace.py)"
    )
    return [f"{place}: {text}\n    {problem.strip()}\n    {advice}"]


# -- the test finds what is wrong -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("cellapp calibrate DIR --priors x", "No such option"),
        ("cellapp collet DIR", "No such command"),
        ("cellapp plan PROFILE && cellapp discover DIR --propose few", "valid integer"),
        ("cellapp export DIR", ""),
        ("cellapp push DIR", "Missing"),
    ],
)
def test_a_wrong_command_is_found(line: str, problem: str) -> None:
    assert problem in not_understood(line, whole=True)
    assert bool(problem) == bool(not_understood(line, whole=True))


def test_an_option_that_acts_while_it_is_parsed_does_not_act(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for option in ("--install-completion", "--version"):
        assert not_understood(f"cellapp {option}", whole=True) == ""
    assert capsys.readouterr().out == ""
    assert not list(tmp_path.iterdir())


def test_the_first_blocks_of_the_readme_are_those_that_ci_runs() -> None:
    first = [example for example in examples("README") if example.language == "sh"][:RUN_BY_CI]
    assert all(not example.words and example.text.startswith("python -m pip install") for example in first)


def test_a_line_that_is_not_printed_is_found() -> None:
    assert not_printed(" a   b\nc ... d\n", "a b  \nc c2 c3 d e\n") == ""
    assert not_printed("a b\nc ... x\n", "a b\nc c2 d\n") == "not printed: c ... x"


def test_lines_that_continue_are_one_command() -> None:
    text = "# why\ncellapp plan PROFILE \\\n  --run DIR\n\ncellapp runs  # all\n"
    found = list(commands(Example(Path("a.md"), 11, "sh", frozenset(), (), text)))
    assert found == [Command("a.md:12", "cellapp plan PROFILE --run DIR"), Command("a.md:15", "cellapp runs  # all")]
