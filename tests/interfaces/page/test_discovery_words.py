"""What discovery found in words and tables: complete, in people's units, within a terminal's width."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.commands.discover.tables import (
    accepted_table,
    candidates_table,
    cycle_table,
    discovery_tables,
    gap_steps,
    invisible_table,
    not_found_table,
    numbered_steps_table,
    size_tables,
    structure_table,
)
from cellapp.commands.discover.view import explanation_text, view
from cellapp.commands.discover.words import (
    contradiction_sentences,
    description_sentences,
    misfit_sentences,
    picture_words,
    remainder_sentences,
    rival_sentences,
)
from cellapp.commands.view.parts import printed
from cellapp.commands.view.table import format_cell
from cellapp.commands.view.words import interval_95, law_words, place_words, probability_words, ranges, short_reason
from cellapp.estimation.discovery.records import (
    BeforeAfter,
    CycleBand,
    DiscoverResult,
    LawRecord,
    Noise,
    Place,
    PlaceMovement,
)
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS
from tests.interfaces.page.cases import (
    ambiguous_compliance,
    data_driven_term,
    discovery,
    free_curve,
    nothing_missing,
    picture,
    unknown_effect,
)
from tests.robot.effects.cell import context_of


def terminal_lines(result: DiscoverResult) -> list[str]:
    """What a terminal shows, tables as their cells, a line each."""
    lines: list[str] = []
    for part in printed(view(result).parts):
        lines += [part] if isinstance(part, str) else [part.title, *("  ".join(row) for row in part.text_rows())]
    return lines


def test_a_terminal_shows_steps_effects_alternatives_what_is_invisible_and_the_verdict() -> None:
    lines = terminal_lines(discovery("left", "right"))
    assert max(len(line) for line in lines) <= 80
    left, right = (" ".join(part.split()) for part in "\n".join(lines).split("\nArm right: nothing missing\n"))
    for text in (
        "Arm left: unknown effect Something that the library does not have",
        "0 geometry alone 0.4906",
        "a data-driven term added 0.0299",
        "final model 0.0312",
        "noise floor 0.0223",
        "1 9 to 37 11 212 2 14 14 80",
        "depends on q2",
        "pedestal_compliance or link_bending would explain these data as well as joint_compliance",
        "Not visible in these data: backlash (no approach signs), tracker_scale (geometry follows nearly all of it).",
        "Law not quite as expected: what joint_compliance moves beside its law is 18 %",
        "Not accepted, but possible: link_bending (13 %).",
        "What is left still depends on time (p below 0.001).",
        "joint_compliance joints 2-4, 6 87 % 0.005 0.4512 0.0312",
        "What it means: joint compliance, joints 2-4, 6",
        "The gears of joints 2, 3, 4 and 6 twist. Usual size: 1 to 3 mm (computed).",
        "Repeat 20 stops with a second payload.",
        "More: 'cellapp docs joint_compliance'",
    ):
        assert text in left
    assert "accepted effects" not in right
    assert "23 um rms" in right or "23 µm rms" in right
    assert "probability of each effect" not in left, "details are left out"


def test_long_words_are_wrapped() -> None:
    arm = unknown_effect("left")
    backlash = arm.invisible[0].model_copy(update={"reason": "not testable: " + "no reason at all " * 9})
    changed = arm.model_copy(update={"invisible": (backlash, arm.invisible[1])})
    lines = terminal_lines(DiscoverResult(arms={"left": changed}))
    assert max(len(line) for line in lines) <= 80
    assert sum("no reason at all" in line for line in lines) > 1


def test_the_explanations_of_all_arms_are_a_text() -> None:
    text = explanation_text(discovery("left", "right"))
    assert text.startswith("Arm left\n  Something behaves like backlash")
    assert "Check or mend" in text
    assert "held-out error after each step" not in text


def test_the_same_steps_everywhere() -> None:
    arm = unknown_effect("left")
    steps = [("geometry alone", 0.4906), ("transmission error: a free curve a joint", 0.1112)]
    assert gap_steps(arm) == [*steps, ("a data-driven term added", 0.0299), ("final model", 0.0312)]
    first, accepted, *sizes, second = discovery_tables(discovery("left", "right"))
    assert sizes == size_tables("left", arm)
    assert first == numbered_steps_table("left", arm)
    assert [row[0] for row in accepted.rows] == ["transmission_error", "joint_compliance", "unknown"]
    assert accepted.text_rows()[1][1:] == ("joints 2-4, 6", "87 %", "0.005", "0.4512", "0.0312")
    assert second.title == "Arm right: held-out error after each step"
    # the last step is the final model: no row of its own
    final = arm.model_copy(update={"heldout_mm": BeforeAfter(before=0.4906, after=0.0299)})
    assert gap_steps(final)[-1] == ("a data-driven term added", 0.0299)


@pytest.mark.parametrize("floor", [None, math.nan])
def test_an_unknown_noise_floor_has_no_row(floor: float | None) -> None:
    result = discovery("left", "right")
    left = result.arms["left"].model_copy(update={"noise_floor_mm": floor, "noise_mm": None})
    result = result.model_copy(update={"arms": {**result.arms, "left": left}})
    table = discovery_tables(result)[0]
    assert "noise floor" not in [row[1] for row in table.rows]
    assert sum("noise floor" in line for line in terminal_lines(result)) == 2  # the other arm's, and its verdict


def test_an_estimated_noise_is_the_floor_and_is_said_to_be_estimated() -> None:
    arm = unknown_effect("left").model_copy(
        update={"noise_floor_mm": None, "noise_mm": Noise(rms=0.031, source="estimated")}
    )
    result = DiscoverResult(arms={"left": arm})
    assert discovery_tables(result)[0].text_rows()[-1] == ("", "estimated noise floor", "0.0310")


def test_probabilities_do_not_claim_certainty() -> None:
    words = [probability_words(p) for p in (None, 0.0, 0.004, 0.5, 0.985, 0.9999, 1.0)]
    assert words == ["", "< 1 %", "< 1 %", "50 %", "98 %", "> 99 %", "> 99 %"]


def test_every_tested_effect_has_its_probability_and_what_is_left_its_tests() -> None:
    arm = unknown_effect("left")
    tested, structure = candidates_table("left", arm), structure_table("left", arm)
    assert tested.text_rows() == (
        ("transmission_error", "> 99 %", "yes"),
        ("joint_compliance", "87 %", "yes"),
        ("link_bending", "13 %", "no"),
        ("backlash", "< 1 %", "no"),
    )
    assert structure.text_rows() == (("joints", "0.41"), ("time", "0.0005"))
    assert not candidates_table("right", nothing_missing("right")).rows
    assert not structure_table("right", nothing_missing("right")).rows


def test_impossible_findings_and_laws_that_hardly_fit_are_sentences() -> None:
    arm = unknown_effect("left")
    assert contradiction_sentences(arm) == [
        "Something behaves like backlash, but of the opposite sign: check the approach convention."
    ]
    (term,) = [found for found in arm.accepted if found.description is not None]
    assert term.description is not None
    same = term.description.model_copy(update={"sentence": arm.contradictions[0].sentence})
    told = arm.model_copy(update={"accepted": (term.model_copy(update={"description": same}),)})
    assert description_sentences(told) == [], "it is no curve without a name"
    (misfit,) = misfit_sentences(arm)
    assert "18 % of what the law moves" in misfit
    exact = arm.accepted[1].model_copy(update={"law_misfit": 0.02})
    assert misfit_sentences(arm.model_copy(update={"accepted": (exact,)})) == []


def test_accepted_effects_with_all_their_evidence() -> None:
    table = accepted_table("left", unknown_effect("left"))
    row = dict(zip(table.headings, table.text_rows()[1]))
    assert row["law"] == "softer below a knee torque; knee at 18.8 Nm for joint 2"
    assert row["score"] == "250.2"
    assert row["answer set"] == "joint_compliance or pedestal_compliance or link_bending"
    assert row["most correlated with"] == "theta2 (+0.73)"
    assert not accepted_table("right", nothing_missing("right")).rows


def test_rivals_that_remain_and_rivals_that_are_ruled_out() -> None:
    remain, ruled_out = rival_sentences(unknown_effect("left"))
    assert remain.startswith("pedestal_compliance or link_bending would explain these data as well as joint_compliance")
    assert ruled_out == "Nearly as good as joint_compliance, but ruled out by these data: tracker_angle_error."
    assert rival_sentences(nothing_missing("right")) == []


def test_parameters_have_intervals_in_people_s_units_and_curves_have_cycles() -> None:
    arm = unknown_effect("left")
    sizes, cycles = size_tables("left", arm), cycle_table("left", arm)
    curve = "rms over a whole turn"
    assert [table.text_rows() for table in sizes] == [
        (("joint 1", curve, "212.400", "µrad"), ("joint 2", curve, "80.000", "µrad")),
        (("compliance2", "16.668", "16.633 to 16.703", "µrad/Nm"),),
        (("joint 5", "rms at the SMR", "22.400", "µm"),),
    ]
    assert cycles.text_rows() == (("1", "9 to 37", "11", "212"), ("2", "14", "14", "80"))
    assert size_tables("right", nothing_missing("right")) == []
    assert not cycle_table("right", nothing_missing("right")).rows


def test_sizes_have_value_unit_and_interval_of_each_joint_the_one_that_moves_the_smr_most_first() -> None:
    found = ambiguous_compliance().model_copy(
        update={
            "parameters": {
                "compliance5": Estimate(value=9.73e-5, standard_error=1.4e-5, unit="rad/Nm"),
                "compliance2": Estimate(value=2.018e-6, standard_error=2.5e-8, unit="rad/Nm"),
            },
            "movements": (
                PlaceMovement(where="joint 2", parameters=("compliance2",), moves_mm=1.3768),
                PlaceMovement(where="joint 5", parameters=("compliance5",), moves_mm=0.0057),
            ),
        }
    )
    curve = free_curve().model_copy(
        update={
            "cycles": {"3": CycleBand(first=2, last=9, peak=2, rms_urad=120.0, rms_standard_error_urad=4.0)},
            "movements": (PlaceMovement(where="joint 3", parameters=(), moves_mm=0.2),),
        }
    )
    arm = unknown_effect("left").model_copy(update={"accepted": (curve, found)})
    first, second = size_tables("left", arm)
    assert first.title == "Arm left: size of joint_compliance, what moves the SMR most first"
    assert first.headings == ("where", "parameter", "value", "95 % interval", "unit", "moves the SMR [mm rms]")
    assert first.text_rows() == (
        ("joint 2", "compliance2", "2.018", "1.969 to 2.067", "µrad/Nm", "1.3768"),
        ("joint 5", "compliance5", "97", "70 to 125", "µrad/Nm", "0.0057"),
    )
    assert second.text_rows() == (("joint 3", "rms over a whole turn", "120.0", "112.2 to 127.8", "µrad", "0.2000"),)


def test_an_estimate_without_standard_error_has_no_interval() -> None:
    number, interval, unit = interval_95(Estimate(value=0.0021, standard_error=None, unit="m"))
    assert (format_cell(number), interval, unit) == ("2.100", None, "mm")


def test_undetected_effects_have_their_reason_and_their_size() -> None:
    arm = unknown_effect("left")
    invisible, absent = invisible_table("left", arm), not_found_table("left", arm)
    assert invisible.text_rows() == (
        ("backlash", "no approach signs", ""),
        ("tracker_scale", "geometry follows nearly all of it", "0.3988"),
    )
    assert absent.text_rows() == (("target_slip", "0.0047", "97"),)


def test_a_term_without_a_name_is_described() -> None:
    arm = unknown_effect("left")
    ((heading, words),) = description_sentences(arm)
    assert heading == "Effect without a name: joint 5, q2"
    assert "22 µm rms" in words
    assert "c |sin(q2)| (score +12.3 against the curve's)" in words
    arm = arm.model_copy(update={"accepted": (data_driven_term(formula="", gain=None),)})
    assert "No short formula" in description_sentences(arm)[0][1]


def test_the_remainder_is_described() -> None:
    text = " ".join(remainder_sentences(unknown_effect("left")))
    assert "1.40 times the stated uncertainty" in text
    assert "below 0.001" in text
    assert "corrects 0.3965 mm rms; trained on what the effects leave, it finds nothing" in text
    assert "median 0.0937 mm, at most 0.3740 mm" in text
    (only,) = remainder_sentences(nothing_missing("right"))
    assert "is 0.42" in only
    arm = nothing_missing("right").model_copy(
        update={"network_mm": BeforeAfter(before=0.02, after=0.02), "scatter": None, "omnibus_p": None}
    )
    assert remainder_sentences(arm) == ["A residual network corrects 0.0200 mm rms of what the geometry leaves."]


def test_notes_of_figures_say_what_they_show() -> None:
    words = picture_words(picture("transmission_error", 1, curve=True))
    assert "scatter 20 µrad rms" in words
    assert "least certain at 128° (150 µrad)" in words
    assert "No reading was taken from 128° to -170°." in words
    plain = picture_words(picture("joint_compliance", 2))
    assert "certain" not in plain
    assert "No reading" not in plain


CONTEXT = context_of()
LAWS = [(slug, law) for slug, effect in EFFECTS.items() for law in effect.laws(CONTEXT)]
LAWS += [
    ("transmission_error", EFFECTS["transmission_error"].law("gear", {"ratio": 100.0})),
    ("transmission_error", EFFECTS["transmission_error"].law("curve", {"cycles": 100.0})),
]


@pytest.mark.parametrize(("slug", "name"), sorted({(slug, law.name) for slug, law in LAWS}))
def test_every_law_has_words(slug: str, name: str) -> None:
    law = next(law for s, law in LAWS if (s, law.name) == (slug, name))
    words = law_words(slug, LawRecord(name=law.name, constants=dict(law.constants)))
    assert words
    assert "_" not in words
    # more than the law's own name: that says nothing to whoever does not know the program
    assert words.split(",")[0] != name.replace("_", " ")


def test_constants_of_a_law_are_in_people_s_units() -> None:
    assert law_words("base_step", LawRecord(name="onset", constants={"onset_s": 5400.0})) == (
        "at once, 1.5 h after the run began"
    )
    assert "time constant 30 min" in law_words(
        "joint_drift", LawRecord(name="warm_up", constants={"first_s": 0.0, "last_s": 3600.0, "tau_s": 1800.0})
    )
    assert "time constant 2.5 s" in law_words(
        "unsettled_measurement", LawRecord(name="creep", constants={"tau_s": 2.5})
    )
    assert "ratio 120" in law_words("transmission_error", LawRecord(name="gear", constants={"ratio": 120.0}))
    assert "11.5 deg" in law_words("backlash", LawRecord(name="saturating", constants={"width": 0.2}))
    assert law_words("unknown", LawRecord(name="base shift|time", constants={"period_s": 1758.0})) == (
        "base shift as a function of time, period 29.3 min"
    )


def test_places() -> None:
    assert place_words(Place(joints=(6, 1, 2, 3), acts_on=())) == "joints 1-3, 6"
    assert place_words(Place(joints=(4,), acts_on=("joint 4",))) == "joint 4"
    assert place_words(Place(joints=(), acts_on=("joint 1", "joint 3"))) == "joints 1, 3"
    assert place_words(Place(joints=(), acts_on=("base", "tool"))) == "base, tool"


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
    number, interval, shown_unit = interval_95(Estimate(value=value, standard_error=error, unit=unit))
    low, high = (float(text) for text in format_cell(interval).split(" to "))
    assert low <= float(format_cell(number)) <= high
    factor = 1e3 if shown_unit == "mm" else 1e6
    assert high - low == pytest.approx(3.92 * error * factor, rel=0.06)


def test_reasons_are_short() -> None:
    assert short_reason("not testable: no times") == "no times"
    assert short_reason("invisible: geometry can follow all of it under this plan") == "geometry can follow all of it"
