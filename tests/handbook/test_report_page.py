"""The chapter on the report: its tables follow the page, its pictures are small and can be taken again."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml

import cellapp.docs
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.report.sections import SECTIONS
from cellapp.ground.errors import InputError
from cellapp.ground.profile.sections import Tolerances
from tests.handbook.chapters import blocks
from tests.handbook.page_pictures import PICTURES, PagePicture, write_pictures

PAGE = chapter_text("report")
FIGURES = Path(cellapp.docs.__file__).parent / "figures"
MOST_BYTES = 150_000


def test_every_section_is_described() -> None:
    missing = [title for title, _ in SECTIONS.values() if title.split(",")[0] not in PAGE]
    assert not missing


def test_the_tolerances_are_a_section_of_a_profile() -> None:
    (example,) = blocks("report", "yaml")
    assert Tolerances.model_validate(yaml.safe_load(example)["tolerances"]).any_given


def test_pictures_are_kept_shown_and_small() -> None:
    kept = {path.stem for path in FIGURES.glob("page-*.png")}
    assert kept == {picture.name for picture in PICTURES}
    for name in kept:
        assert f"(figures/{name}.png)" in PAGE
        assert (FIGURES / f"{name}.png").stat().st_size < MOST_BYTES


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a page of two parts, one of them folded."""
    pytest.importorskip("playwright.sync_api", reason="no Playwright here; install the dev extra")
    if shutil.which("chromium") is None:
        pytest.skip("no chromium here; Debian's package chromium has it")
    text = "<!DOCTYPE html><p>first</p><details id='a'><summary>a</summary><div style='height:3000px'>b</div></details>"
    (tmp_path / "report.html").write_text(text, encoding="utf-8")
    return tmp_path


def test_pictures_are_taken_of_windows_and_parts(folder: Path) -> None:
    from PIL import Image

    wanted = (PagePicture("window", size=(320, 200), dark=True), PagePicture("part", "#a", most_height=500))
    taken = write_pictures(folder, folder / "new", wanted)
    assert [path.name for path in taken] == ["window.png", "part.png"]
    with Image.open(taken[0]) as window, Image.open(taken[1]) as part:
        assert window.size == (320, 200)
        assert part.size[1] == 500, "a folded part is opened, a long one cut"
    with pytest.raises(InputError, match=r"none\.html is missing"):
        write_pictures(folder, folder / "new", (PagePicture("x", file="none.html"),))
