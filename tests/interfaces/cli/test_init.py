"""``cellapp init``: a profile in an empty folder; a second time, an unknown name or two sources get a sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.profile import load_profile
from tests.interfaces.cli.test_cli import call, one_sentence  # noqa: F401 - a fixture


def test_the_twin_in_an_empty_folder(call: Any) -> None:  # noqa: F811
    ended = call("init", "--twin", "--json", "-")
    assert ended.code == 0
    assert ended.json["profile"] == str(Path("profiles") / "twin.yaml")
    assert "next: cellapp doctor" in ended.err
    assert load_profile(Path("profiles/twin.yaml")).name == "twin"
    one_sentence(call("init", "--twin"), "twin.yaml exists already; nothing was written")


def test_answers_into_another_folder(call: Any) -> None:  # noqa: F811
    call("init", "--from", "ur5-real")
    Path("a.yaml").write_text(
        "name: one\narms: {left: {type: ur5, driver: {kind: none}, smr: {offset: unknown}}}\n"
        "tracker: {driver: {kind: none}}\n",
        "utf-8",
    )
    ended = call("init", "elsewhere", "--answers", "a.yaml", "--json", "init.json")
    assert (ended.code, json.loads(Path("init.json").read_text("utf-8"))["schema"]) == (0, "cellapp-init")
    assert [*load_profile(Path("elsewhere/profiles/one.yaml")).arms] == ["left"]
    one_sentence(call("init", "elsewhere", "--answers", "b.yaml"), "b.yaml: file not found")


@pytest.mark.parametrize("arguments", [(), ("--twin", "--from", "twin")])
def test_one_source_is_needed(call: Any, arguments: tuple[str, ...]) -> None:  # noqa: F811
    ended = call("init", *arguments)
    assert ended.code == 2
    assert "give one of --twin, --from NAME, --answers FILE and --readings FILE" in ended.err
    assert "ur10-ur5       The real cell" in ended.err
    one_sentence(call("init", "--from", "tvin"), "'tvin' is no profile that comes with cellapp; there are twin,")
