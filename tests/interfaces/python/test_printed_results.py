"""Results print themselves: one line, a report with the figures that the commands print, valid HTML, charts."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

import cellapp


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


NAMES = ("cell", "readings", "run", "calibration", "discovery", "compensation", "model", "arm", "readings of an arm")


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


def test_reports_hold_the_figures(run: cellapp.Run) -> None:
    left = run.calibration.result.arms["left"]
    report = run.calibration.report()
    assert f"{left.validate_['geometry'].position_mm.mean:.4f}" in report
    assert all(name in report for name in left.identified)
    found = run.discovery.result.arms["left"]
    assert f"{found.heldout_mm.after:.4f}" in run.discovery.report()
    assert found.sentence.removeprefix("arm left: ")[:30] in run.discovery.report()
    assert str(run.discovery) == run.discovery.report()
    assert max(map(len, run.calibration.report(width=60).splitlines()[:12])) <= 60


def test_charts_are_drawn_by_name(run: cellapp.Run, tmp_path: Path) -> None:
    for result in (run.calibration, run.discovery):
        for name in result.charts():
            assert "<svg " in result.plot(name).html
    effects = run.discovery.plot("effects")
    assert "Arm left: " in effects._repr_html_()
    assert "--geometry: #" in effects.html
    effects.save(tmp_path / "effects.html")
    assert (tmp_path / "effects.html").read_text("utf-8") == effects.html
    with pytest.raises(cellapp.InputError, match="plot: nothing is called 'error'; known are steps, errors, effects"):
        run.discovery.plot("error")


def test_a_run_without_results_says_so(run: cellapp.Run, tmp_path: Path) -> None:
    early = cellapp.Run(tmp_path, run.profile, {}, type(run.results)(run=str(tmp_path)), None)
    assert "readings: none, no results" in repr(early)
    with pytest.raises(cellapp.InputError, match="not calibrated yet; run 'cellapp calibrate"):
        _ = early.calibration
    with pytest.raises(cellapp.InputError, match="no discovery is stored; run 'cellapp discover"):
        _ = early.discovery
