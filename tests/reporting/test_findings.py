"""What discovery found in words and tables: complete, in people's units, within a terminal's width."""

from __future__ import annotations

import copy
import math

import pytest
from cellapp.reporting.findings import (
    accepted_table,
    cycle_table,
    description_sentences,
    discovery_lines,
    discovery_tables,
    gap_steps,
    gap_table,
    invisible_table,
    not_found_table,
    parameter_table,
    picture_words,
    rest_sentences,
)
from hypothesis import given
from hypothesis import strategies as st

from cellapp.effects import EFFECTS, Law
from cellapp.reporting.words import interval_95, law_words, place_words, ranges, short_reason
from tests.effects.cell import context_of
from tests.reporting.made import made_arm, made_picture, made_result, nothing_missing

MOST_LINES = 25


def test_a_terminal_shows_the_five_things_in_few_lines() -> None:
    lines = discovery_lines(made_result("left", "right"))
    assert max(len(line) for line in lines) <= 80
    left, right = "\n".join(lines).split("\nArm right\n")
    assert len(left.splitlines()) <= MOST_LINES
    assert len(right.splitlines()) <= MOST_LINES
    for text in (
        "0.4906  geometry alone",
        "0.0299  a data-driven term added",
        "0.0312  the model that is kept",
        "0.0223  noise floor",
        "joint 1: 9-37 (212 urad rms), joint 2: 14 (80 urad rms)",
        "joint 5 depends on q2, about c |sin(q2)|",
        "or instead   of joint_compliance: pedestal_compliance or link_bending",
        "not visible  backlash: no approach signs\n",
        "tracker_scale: geometry follows nearly all of it\n",
        "verdict      unknown effect: something that the library does not have",
    ):
        assert text in left
    (row,) = [line.split() for line in left.splitlines() if line.startswith("  joint_compliance")]
    assert row == ["joint_compliance", "joints", "2-4,", "6", "0.005", "0.4512", "->", "0.0312"]
    assert "accepted" not in right
    assert "verdict      nothing missing: 23 um rms" in right


def test_long_words_are_wrapped_and_long_reasons_are_cut() -> None:
    result = made_result("left", "right")
    arm = result["arms"]["left"]
    arm["steps"][1]["what"] = "dropped in review: " + ", ".join(["encoder eccentricity (one cycle a turn)"] * 4)
    arm["invisible"][0]["reason"] = "not testable: " + "no reason at all " * 9
    lines = discovery_lines(result)
    assert max(len(line) for line in lines) <= 80
    assert sum("eccentricity" in line for line in lines) > 1
    assert sum("no reason at all" in line for line in lines) == 1


def test_the_same_steps_everywhere() -> None:
    arm = made_arm("left")
    steps = [("geometry alone", 0.4906), ("transmission error: a free curve a joint", 0.1112)]
    assert gap_steps(arm) == [*steps, ("a data-driven term added", 0.0299), ("the model that is kept", 0.0312)]
    first, accepted, second = discovery_tables(made_result("left", "right"))
    assert first.title == "Arm left: unknown effect"
    assert [row[-1] for row in first.rows] == [row[-1] for row in gap_table("left", arm).rows]
    assert [row[0] for row in accepted.rows] == ["transmission_error", "joint_compliance", "unknown"]
    assert accepted.rows[1][1:] == ("joints 2-4, 6", "0.005", "0.4512", "0.0312")
    assert second.title == "Arm right: nothing missing"
    # what the last step left is what is kept: told once
    arm["heldout_mm"]["after"] = 0.0299
    assert gap_steps(arm)[-1] == ("a data-driven term added", 0.0299)


@pytest.mark.parametrize("floor", [None, math.nan])
def test_a_noise_floor_that_nobody_knows_has_no_row(floor: float | None) -> None:
    result = made_result("left", "right")
    result["arms"]["left"]["noise_floor_mm"] = floor
    table = discovery_tables(result)[0]
    assert "noise floor" not in [row[0] for row in table.rows]
    assert sum("noise floor" in line for line in discovery_lines(result)) == 2  # the other arm's, and its verdict


def test_results_of_an_older_version_are_left_out() -> None:
    result = made_result("left", "right")
    del result["arms"]["left"]["steps"]
    assert discovery_tables(result) == []
    assert discovery_lines(result) == []


def test_accepted_effects_with_all_their_evidence() -> None:
    table = accepted_table("left", made_arm("left"))
    assert table is not None
    row = dict(zip(table.columns, table.rows[1]))
    assert row["law"] == "softer below a knee torque; knee at 18.8 Nm for joint 2"
    assert row["score"] == "250.2"
    assert row["answer set"] == "joint_compliance or pedestal_compliance or link_bending"
    assert row["most correlated with"] == "theta2 (+0.73)"
    assert accepted_table("right", nothing_missing("right")) is None


def test_parameters_have_intervals_in_people_s_units_and_curves_have_cycles() -> None:
    arm = made_arm("left")
    parameters, cycles = parameter_table("left", arm), cycle_table("left", arm)
    assert parameters is not None
    assert cycles is not None
    assert parameters.rows == (("joint_compliance", "compliance2", "16.668", "16.633 to 16.703", "µrad/Nm"),)
    assert cycles.rows == (("1", "9 to 37", "11", "212"), ("2", "14", "14", "80"))
    assert parameter_table("right", nothing_missing("right")) is None
    assert cycle_table("right", nothing_missing("right")) is None


def test_what_cannot_be_said_has_its_reason_and_its_size() -> None:
    arm = made_arm("left")
    invisible, absent = invisible_table("left", arm), not_found_table("left", arm)
    assert invisible is not None
    assert absent is not None
    assert invisible.rows == (
        ("backlash", "no approach signs", ""),
        ("tracker_scale", "geometry follows nearly all of it", "0.3988"),
    )
    assert absent.rows == (("target_slip", "0.0047", "97"),)


def test_a_term_without_a_name_is_described() -> None:
    arm = made_arm("left")
    ((heading, words),) = description_sentences(arm)
    assert heading == "No name for this: joint 5, q2"
    assert "22 µm rms" in words
    assert "c |sin(q2)| (score +12.3 against the curve's)" in words
    arm["accepted"][2]["description"].update(formula="", gain_over_curve=None)
    assert "No short formula" in description_sentences(arm)[0][1]


def test_what_remains_is_told() -> None:
    text = " ".join(rest_sentences(made_arm("left")))
    assert "1.40 times as the readings state" in text
    assert "below 0.001" in text
    assert "corrects 0.3965 mm rms; trained on what the effects leave, it finds nothing" in text
    assert "0.0937 mm in the middle and 0.3740 mm at most" in text
    (only,) = rest_sentences(nothing_missing("right"))
    assert "is 0.42" in only
    arm = nothing_missing("right")
    arm.update(network_mm={"before": 0.02, "after": 0.02}, scatter=None, omnibus_p=None)
    assert rest_sentences(arm) == ["A residual network corrects 0.0200 mm rms of what the geometry leaves."]


def test_captions_say_what_one_sees() -> None:
    words = picture_words(made_picture("transmission_error", 1, curve=True))
    assert "scatter 20 µrad rms" in words
    assert "least sure at 128° (150 µrad)" in words
    assert "No reading was taken from 128° to -170°." in words
    plain = picture_words(made_picture("joint_compliance", 2))
    assert "sure" not in plain
    assert "No reading" not in plain


def test_nothing_is_changed_by_telling_it() -> None:
    result = made_result("left", "right")
    before = copy.deepcopy(result)
    discovery_lines(result)
    discovery_tables(result)
    assert result == before


CONTEXT = context_of()
LAWS = [(slug, law) for slug, effect in EFFECTS.items() for law in effect.laws(CONTEXT)]
LAWS += [("transmission_error", Law("gear", {"ratio": 100.0})), ("transmission_error", Law("curve", {"cycles": 100.0}))]


@pytest.mark.parametrize(("slug", "name"), sorted({(slug, law.name) for slug, law in LAWS}))
def test_every_law_has_words(slug: str, name: str) -> None:
    law = next(law for s, law in LAWS if (s, law.name) == (slug, name))
    words = law_words(slug, {"name": law.name, "constants": dict(law.constants)})
    assert words
    assert "_" not in words
    # more than the law's own name: that says nothing to whoever does not know the program
    assert words.split(",")[0] != name.replace("_", " ")


def test_constants_of_a_law_are_in_people_s_units() -> None:
    assert law_words("base_step", {"name": "onset", "constants": {"onset_s": 5400.0}}) == (
        "at once, 1.5 h after the run began"
    )
    assert "time constant 30 min" in law_words("joint_drift", {"name": "warm_up", "constants": {"tau_s": 1800.0}})
    assert "time constant 2.5 s" in law_words("unsettled_measurement", {"name": "creep", "constants": {"tau_s": 2.5}})
    assert "ratio 120" in law_words("transmission_error", {"name": "gear", "constants": {"ratio": 120.0}})
    assert "11.5 deg" in law_words("backlash", {"name": "saturating", "constants": {"width": 0.2}})
    assert law_words("unknown", {"name": "base shift|time", "constants": {"period_s": 1758.0}}) == (
        "base shift as a function of time, period 29.3 min"
    )


def test_places() -> None:
    assert place_words({"joints": [6, 1, 2, 3], "acts_on": []}) == "joints 1-3, 6"
    assert place_words({"joints": [4], "acts_on": ["joint 4"]}) == "joint 4"
    assert place_words({"joints": [], "acts_on": ["joint 1", "joint 3"]}) == "joints 1, 3"
    assert place_words({"joints": [], "acts_on": ["base", "tool"]}) == "base, tool"


@given(st.sets(st.integers(1, 12)))
def test_ranges_hold_the_same_numbers(numbers: set[int]) -> None:
    found: list[int] = []
    for part in filter(None, ranges(sorted(numbers)).split(", ")):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    assert found == sorted(numbers)


@given(
    st.floats(-1e-2, 1e-2, allow_subnormal=False),
    st.floats(1e-9, 1e-3),
    st.sampled_from(["rad", "m", "rad/Nm", "1/K", "1/(N m^2)", "m/K"]),
)
def test_intervals_hold_the_value_and_are_as_wide_as_stated(value: float, error: float, unit: str) -> None:
    shown, interval, shown_unit = interval_95({"value": value, "standard_error": error, "unit": unit})
    low, high = (float(text) for text in interval.split(" to "))
    assert low <= float(shown) <= high
    factor = 1e3 if shown_unit == "mm" else 1e6
    assert high - low == pytest.approx(3.92 * error * factor, rel=0.06)


def test_reasons_are_short() -> None:
    assert short_reason("not testable: no times") == "no times"
    assert short_reason("invisible: geometry can follow all of it under this plan") == "geometry can follow all of it"
