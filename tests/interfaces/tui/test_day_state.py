"""Every sentence about the state of a run comes from one state: all states, through all screens and all their tabs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from cellapp.commands.next_step import stage_conclusions
from cellapp.interfaces.tui.day_state import SIGNS, marks_of
from cellapp.interfaces.tui.keys import with_keys
from cellapp.interfaces.tui.workspace import load_workspace
from tests.approved import assert_approved
from tests.interfaces.tui.states import states_table
from tests.sure import sure

COMMAND = re.compile(r"'cellapp |\bcellapp (?:plan|collect|calibrate|discover|push|report|check|iso9283|locate)\b")


def test_each_state_says_what_was_approved() -> None:
    shown = "\n".join(" | ".join(row) for row in states_table())
    assert not COMMAND.search(shown), "screens name keys"
    assert_approved(Path(__file__).parent / "snapshots" / "states.txt", re.sub(r"\d\d:\d\d", "00:00", shown))


# -- the marks ---------------------------------------------------------------------------------------------------------


def test_a_tick_is_no_verdict(finished_run: Path) -> None:
    held = load_workspace(None, finished_run)
    verify = sure(sure(held.results).verify)
    stopped = verify.model_copy(update={"stopped": "stopped after 3 of 40 targets: link lost"})
    signs = {}
    for kind, result in (("done", verify), ("part", stopped)):
        results = sure(held.results).model_copy(update={"verify": result})
        mark = marks_of(replace(held, results=results, conclusions=stage_conclusions(results)), 1, 1, 0, None)[
            "targets"
        ]
        signs[kind] = SIGNS[mark.kind]
        if kind == "part":
            assert mark.words == "stopped after 3 of 40 targets"
    assert signs["part"] == "◐"
    assert signs["done"] in "✓≤?✗"
    assert len(set(SIGNS.values())) == len(SIGNS), "each conclusion has its own mark"


@pytest.mark.parametrize(
    ("conformity", "sign"), [("conforms", "≤"), ("not decided", "?"), ("does not conform", "✗"), (None, "✓")]
)
def test_the_mark_of_accept_is_the_verdict(conformity: str | None, sign: str, finished_run: Path) -> None:
    held = replace(load_workspace(None, finished_run), reported=True, conformity=conformity)  # type: ignore[arg-type]
    assert SIGNS[marks_of(held, 1, 1, 0, None)["accept"].kind] == sign


def test_sentences_name_keys_and_no_commands() -> None:
    assert with_keys("report.html is old; run 'cellapp report logs/a'") == "report.html is old; keys 7, b"
    assert with_keys("Measure them: cellapp push DIR TARGETS --verify") == "Measure them: keys 6, m"
    assert with_keys("next: cellapp docs targets") == "next: keys 6, m"
    assert with_keys("run 'cellapp iso9283 PROFILE --run DIR', then go on") == "keys 7, m, then go on"
    assert with_keys("More: 'cellapp docs joint_compliance'") == "More: key F1"
    assert with_keys("no runs below logs; 'cellapp run PROFILE' makes one") == "no runs below logs; key F5 makes one"
    assert with_keys("cellapp is a program") == "cellapp is a program"
