"""What commands say can be done as it stands: printed commands, near words, units, suffixes."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.interfaces.cli.test_cli import call, exit_code, one_sentence  # noqa: F401 - a fixture
from tests.twin import PROFILES


@pytest.fixture
def folder(call: Any, finished_run: Path) -> Path:  # noqa: F811
    return Path(shutil.copytree(finished_run, Path("my cell") / "a $run"))


def test_printed_commands_run_in_folders_with_blanks(call: Any, folder: Path) -> None:  # noqa: F811
    texts = [
        call("show", folder, "--json", "-").json["next_step"],
        call("plan", PROFILES / "twin.yaml", "--run", folder).err,
    ]
    printed = [
        said for text in texts for said in re.findall(r"cellapp (?!:)[a-z].*?(?=' |'$|$)", " ".join(text.split()))
    ]
    assert len(printed) == 2
    for command in printed:
        assert str(folder) in shlex.split(command.replace("\\$", "$")), command


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("docs backlsh", "did you mean 'backlash'?"),
        ("show FOLDER log --level foo", "foo"),
        ("export FOLDER --as dh --out arm.json", "is written as .yaml, not as .json: give --out arm.yaml"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(call: Any, folder: Path, words: str, says: str) -> None:  # noqa: F811
    refused = call(*[str(folder) if word == "FOLDER" else word for word in words.split()])
    assert refused.code == 2
    assert says in " ".join(refused.err.split())


def test_a_table_of_parameters_says_what_it_holds(call: Any, folder: Path) -> None:  # noqa: F811
    call("export", folder, "--as", "parameters", "--out", "p.csv", "--arm", "left")
    head = Path("p.csv").read_text("utf-8")
    assert "does not hold" not in head
    assert "joint_compliance." in head


def test_parameters_are_those_of_the_model_in_force(call: Any, folder: Path) -> None:  # noqa: F811
    call("export", folder, "--as", "parameters", "--out", "p.csv", "--arm", "left")
    exported = [line.split(",") for line in Path("p.csv").read_text("utf-8").splitlines() if not line.startswith("#")]
    values = {row[0]: float(row[3]) for row in exported[1:]}
    shown = call("show", folder, "parameters", "--json", "-").json["arms"]["left"]["identified"]
    assert len(shown) > 20
    assert {name: one["value"] for name, one in shown.items()} == pytest.approx({name: values[name] for name in shown})
