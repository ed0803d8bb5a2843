"""The chapter on plug-ins prints the example as it is, and names every group of entry points."""

from __future__ import annotations

import re
from pathlib import Path

from cellapp.commands.docs.handbook import chapter_text, topic_text
from cellapp.commands.doctor.run import installed_findings
from tests.interfaces.plugins.installed import EXAMPLE, REGISTRIES, add_example, installed

INCLUDED = re.compile(r"<!-- file: (\S+) -->\n```[\w ]+\n(.*?)```\n", re.DOTALL)


def test_the_example_is_printed_whole_and_as_it_is() -> None:
    printed = dict(INCLUDED.findall(chapter_text("extend")))
    files = {path.relative_to(EXAMPLE).as_posix(): path for path in EXAMPLE.rglob("*.*") if path.suffix != ".pyc"}
    assert {*printed, "cellapp_example/__init__.py"} == set(files), "its package says no more than what it is"
    for name, text in printed.items():
        assert text == files[name].read_text("utf-8"), f"copy {name} into the chapter again"


def test_every_group_is_in_the_table() -> None:
    rows = re.findall(r"^\| `(cellapp\.[\w.]+)` \|", chapter_text("extend"), re.MULTILINE)
    assert set(rows) == {registry.group for registry in REGISTRIES}


def test_what_the_chapter_shows_is_what_the_program_says(tmp_path: Path) -> None:
    with installed(add_example(tmp_path)):
        (finding,) = installed_findings()
        section = topic_text("hose_pull")
    assert f"ok       {finding.subject}: {finding.text}" in chapter_text("extend")
    assert section.startswith("## hose_pull\n\n*pull of the hose package.*")
    assert "**Usual size** (estimate). 0.1 to 0.5 mrad for each radian beyond." in section
