"""What discovery found in words and tables: complete, in people's units, within a terminal's width."""

from __future__ import annotations

import pytest

from cellapp.commands.discover.tables import (
    discovery_tables,
    gap_steps,
    numbered_steps_table,
    size_tables,
)
from cellapp.commands.discover.view import view
from cellapp.commands.discover.words import (
    contradiction_sentences,
    description_sentences,
    misfit_sentences,
)
from cellapp.commands.view.parts import printed
from cellapp.commands.view.words import law_words, probability_words
from cellapp.estimation.discovery.records import (
    BeforeAfter,
    DiscoverResult,
    LawRecord,
    Noise,
)
from cellapp.robot.effects import EFFECTS
from tests.interfaces.page.cases import (
    discovery,
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


def test_an_estimated_noise_is_the_floor_and_is_said_to_be_estimated() -> None:
    arm = unknown_effect("left").model_copy(
        update={"noise_floor_mm": None, "noise_mm": Noise(rms=0.031, source="estimated")}
    )
    result = DiscoverResult(arms={"left": arm})
    assert discovery_tables(result)[0].text_rows()[-1] == ("", "estimated noise floor", "0.0310")


def test_probabilities_do_not_claim_certainty() -> None:
    words = [probability_words(p) for p in (None, 0.0, 0.004, 0.5, 0.985, 0.9999, 1.0)]
    assert words == ["", "< 1 %", "< 1 %", "50 %", "98 %", "> 99 %", "> 99 %"]


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
