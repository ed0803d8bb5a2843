"""What a finished run says, on the terminal and on the page: no double stop, one spelling of units, words for keys."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.commands.registry import records
from cellapp.ground.errors import InputError
from cellapp.interfaces.page.page import page_text
from tests.interfaces.page.parsed_page import NOON
from tests.program import app

FAULTS = {
    "a double full stop": re.compile(r"[\w)]\.\.(?![./\w])"),
    "one of several": re.compile(
        r"(?<![\w.,-])1 (arms|checks|cycles|effects|errors|iterations|parameters|points|readings|rows|stops|targets)\b"
    ),
    "micro without its sign": re.compile(r"\d u(m|rad)\b"),
    "a key for people": re.compile(r"\bmethod_\d\b"),
    "two spaces in a sentence": re.compile(r"(?m)^(?!.*  .*  )\w[\w ,]*[a-z]  [a-z][\w ,]*\.$"),
}


def faults_of(text: str) -> Iterator[str]:
    for name, pattern in FAULTS.items():
        for found in pattern.finditer(text):
            yield f"{name}: ...{text[max(found.start() - 50, 0) : found.end() + 30]}..."


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("that is it.. U is", "a double full stop"),
        ("of 1 targets", "one of several"),
        ("27 um rms", "micro without its sign"),
        ("method_1 0.39", "a key for people"),
    ],
)
@pytest.mark.fast
def test_the_faults_are_found(text: str, name: str) -> None:
    (found,) = faults_of(text)
    assert found.startswith(name)


def test_a_finished_run_is_shown_without_them(finished_run: Path) -> None:
    parts = [stored.part for verb in records() for stored in verb.stored]
    assert len(parts) > 5
    shown = []
    for part in ("", *parts):
        ended = CliRunner().invoke(app, ["show", str(finished_run), *filter(None, [part])])
        assert ended.exit_code == 0 or isinstance(ended.exception, InputError), part  # this run has none
        shown.append(ended.output)
    assert sum("mm" in text for text in shown) > 4
    assert list(faults_of("\n".join(shown))) == []


def test_its_page_has_none(finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        page = page_text(run, NOON)
    page = re.sub(r"(?s)<(script|style|svg).*?</\1>", " ", page)
    text = html.unescape(re.sub(r"<[^>]+>", " ", page))
    assert "Errors against" in text or "errors" in text
    assert list(faults_of(re.sub(r"\s+", " ", text))) == []
