"""Results print themselves: one line, a report with the figures that the commands print, valid HTML, charts."""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import cellapp


@pytest.fixture(scope="module")
def run(finished_run: Path) -> cellapp.Run:
    return cellapp.open_run(finished_run)


@pytest.fixture(scope="module")
def results(run: cellapp.Run) -> dict[str, object]:
    target = {"name": "<A & B>", "arm": "left", "position": [0.6, 0.2, 0.4]}
    return {
        "cell": cellapp.Cell(run.profile),
        "readings": cellapp.Cell(run.profile).readings(run.measured),
        "run": run,
        "calibration": run.calibration,
        "discovery": run.discovery,
        "compensation": run.discovery.compensate([target]),
        "model": run.model,
        "arm": run.calibrated_model().arms["left"],
        "readings of an arm": run.readings("left"),
    }


NAMES = (
    "cell",
    "readings",
    "run",
    "calibration",
    "discovery",
    "compensation",
    "model",
    "arm",
    "readings of an arm",
)


@pytest.mark.parametrize("name", NAMES)
def test_repr_is_one_short_line(results: dict[str, object], name: str) -> None:
    text = repr(results[name])
    assert "\n" not in text
    assert 10 < len(text) < 200
    assert text.startswith(type(results[name]).__name__)


class Checker(HTMLParser):
    """Notes elements that are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.mark.parametrize("name", NAMES[:6])
def test_html_is_valid_and_says_what_the_report_says(results: dict[str, object], name: str) -> None:
    result = results[name]
    checker = Checker()
    checker.feed(result._repr_html_())  # type: ignore[attr-defined]
    assert checker.open == []
    said = " ".join(checker.texts)
    missing = [word for word in str(result).split() if word.strip("─") and word not in said]
    assert not missing
    if name == "compensation":
        assert "<A & B>" in said


def test_charts_are_drawn_by_name(run: cellapp.Run) -> None:
    pytest.importorskip("matplotlib")
    for result in (run.calibration, run.discovery):
        for name in result.charts():
            figure = result.plot(name)
            assert all(axes.get_title().startswith(("Arm", "Pair")) for axes in figure.axes)
    steps = run.discovery.plot()
    (line, *_) = steps.axes[0].get_lines()
    assert np.allclose(
        np.asarray(line.get_ydata()), [step.heldout_mm for step in run.discovery.result.arms["left"].steps]
    )
    assert steps.axes[0].get_yscale() == "log"
    with pytest.raises(cellapp.InputError, match="plot: nothing is called 'error'; known are steps, candidates,"):
        run.discovery.plot("error")


def test_without_matplotlib_the_extra_is_named(run: cellapp.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"plots need matplotlib; install it with: pip install 'cellapp\[plot\]'"):
        run.calibration.plot()


def test_a_run_without_results_says_so(run: cellapp.Run, tmp_path: Path) -> None:
    early = cellapp.Run(tmp_path, run.profile, {}, type(run.results)(run=str(tmp_path)), None)
    assert "readings: none, no results" in repr(early)
    with pytest.raises(cellapp.InputError, match="not calibrated yet; run 'cellapp calibrate"):
        _ = early.calibration
    with pytest.raises(cellapp.InputError, match="no discovery is stored; run 'cellapp discover"):
        _ = early.discovery
