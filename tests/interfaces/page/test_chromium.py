"""Printing through an installed Chromium: none there, one that fails, one that never ends. The browsers are scripts."""

from __future__ import annotations

import os
import select
import stat
from pathlib import Path

import pytest

from cellapp.ground.chromium import find_chromium, print_pdf
from cellapp.ground.errors import InputError


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "report.html"
    path.write_text("<!DOCTYPE html><title>t</title>", encoding="utf-8")
    return path


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str, name: str = "chromium") -> Path:
    """Put a browser that is a shell script on a search path of its own."""
    browser = folder / "bin" / name
    browser.parent.mkdir()
    browser.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    browser.chmod(browser.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{browser.parent}:/usr/bin:/bin" if name == "chromium" else str(browser.parent))
    return browser


PRINTS = 'for word; do case "$word" in --print-to-pdf=*) echo "%PDF $*" > "${word#--print-to-pdf=}";; esac; done'


def test_no_browser_is_said_with_what_to_do(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"no Chromium is installed here.*install one.*print it there"):
        print_pdf(page, tmp_path / "out.pdf")
    assert not (tmp_path / "out.pdf").exists()


def test_other_names_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    browser = install(tmp_path, monkeypatch, "", "google-chrome")
    assert find_chromium() == browser


def test_prints_with_a_profile_of_its_own(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, PRINTS)
    print_pdf(page, tmp_path / "out.pdf")
    words = (tmp_path / "out.pdf").read_text("utf-8").split()
    assert words[-1] == page.as_uri()
    (profile,) = (word.removeprefix("--user-data-dir=") for word in words if word.startswith("--user-data-dir="))
    assert not Path(profile).parent.exists(), "nothing is left behind"
    assert ("--no-sandbox" in words) == (os.geteuid() == 0)


def test_a_browser_that_prints_nothing_is_named(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, "echo 'no memory left' >&2; exit 5")
    with pytest.raises(InputError, match=r"chromium printed nothing \(no memory left\)"):
        print_pdf(page, tmp_path / "out.pdf")


def test_a_browser_that_does_not_end_is_ended_with_its_children(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alive = tmp_path / "alive"
    os.mkfifo(alive)
    install(tmp_path, monkeypatch, f"sleep 600 > {alive} & echo > {alive}; wait")
    reader = os.open(alive, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with pytest.raises(InputError, match=r"did not print within 0\.5 s and was ended"):
            print_pdf(page, tmp_path / "out.pdf", timeout_s=0.5)
        assert os.read(reader, 1) == b"\n", "the browser and its child have begun"
        assert select.select([reader], [], [], 10.0)[0]
        assert os.read(reader, 1) == b"", "nobody holds the other end any more"
    finally:
        os.close(reader)


def test_a_file_that_cannot_be_written(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, PRINTS)
    with pytest.raises(InputError, match=r"out\.pdf: cannot be written"):
        print_pdf(page, tmp_path / "none" / "out.pdf")
