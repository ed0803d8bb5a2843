"""Stops with several loads: one session for each, nobody moves an arm whose load is in doubt."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.cell_checks import Hung, carrying, hung_load, known_payload
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import PlannedStops, read_planned_stops, write_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.collect.request import CollectRequest
from cellapp.ground.control import Stopped
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Payload
from cellapp.ground.profile.sections import Collection, Reference
from drivers.arms.protocol import ArmState
from drivers.arms.simulated import SimulatedArm
from tests.sure import sure
from tests.twin import small_twin, with_arm
from tests.verbs import collect_by

STOPS = 6
HEAVY = Payload(mass=5.0, center_of_mass=(0.0, 0.0, 0.06))


def loaded(*payloads: Payload, stops: int = STOPS) -> Profile:
    return with_arm(small_twin(stops, plan={"method": "random", "repeats": 0}), "left", payloads=payloads)


@pytest.fixture(scope="module")
def planned() -> tuple[Profile, PlannedStops]:
    profile = loaded(HEAVY)
    collection = Collection(reference=Reference(every=100, drift=0.01))
    return profile.model_copy(update={"collection": collection}), make_stops(profile)[0]


@pytest.fixture
def run(planned: tuple[Profile, PlannedStops], tmp_path: Path) -> Iterator[RunFile]:
    with RunFile.create(tmp_path / "run", planned[0]) as run:
        write_planned_stops(run, planned[1])
        yield run


def by_person(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loads of this cell are changed by a person."""
    monkeypatch.setattr(Profile, "cell_kind", "real")


def answers(asked: list[str], *, hangs: bool) -> Hung:
    """A person who is asked to hang a load."""

    def hung(words: str) -> bool:
        asked.append(words)
        return hangs

    return hung


def test_stops_are_divided_among_loads_and_kept_ones_keep_theirs() -> None:
    profile = loaded(HEAVY, Payload(mass=2.0))
    stops, _ = make_stops(profile)
    assert stops.load.tolist() == [0, 0, 1, 1, 2, 2]
    more, _ = make_stops(profile, kept=stops, add=2)
    assert more.load.tolist() == [0, 0, 1, 1, 2, 2, 2, 2]
    with pytest.raises(InputError, match="2 stops are too few for 3 loads"):
        make_stops(loaded(HEAVY, HEAVY, stops=2))


def test_a_simulated_cell_hangs_its_loads_and_every_reading_says_which(run: RunFile) -> None:
    assert collect_run(run).outcome == "complete"
    left, right = run.readings("left"), run.readings("right")
    first = run.profile.arms["left"].payload.mass
    assert sure(left.payload_kg).tolist() == [first] * 3 + [5.0] * 3
    np.testing.assert_allclose(sure(left.payload_center_F)[3:], [HEAVY.center_of_mass] * 3)
    assert (np.diff(left.time_s) > 0.0).all()  # one cell, whose time and effects go on
    assert len(set(sure(right.payload_kg).tolist())) == 1
    assert len(run.sessions()) == 2
    assert hung_load(run) == 1
    names = [row.name for row in run.references()]
    assert names.count("arm left") == 2
    assert names.count("arm left with 5 kg") == 2
    assert names.count("arm right") == 4


def test_nothing_moves_before_a_person_has_hung_the_load(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    by_person(monkeypatch)
    opened = list[float]()
    asked = list[str]()

    @contextmanager
    def watched(profile: Profile, **options: Any) -> Iterator[Cell]:
        opened.append(profile.arms["left"].payload.mass)
        with open_cell(profile, **options) as cell:
            yield cell

    with pytest.raises(Stopped, match=r"hang 5 kg.*--resume --payload left=5"):
        collect_by(watched, run, hung=answers(asked, hangs=False))
    assert opened == [run.profile.arms["left"].payload.mass]
    assert run.stops_done() == {0, 1, 2}
    assert len(asked) == 1
    assert "at (0, 0, 60) mm in the flange frame" in asked[0]
    with pytest.raises(InputError, match="said to carry 3 kg, the next stops need 5 kg"):
        collect_by(watched, run, resume=True, payload={"left": 3.0})
    with pytest.raises(InputError, match="no arm 'middle'"):
        collect_by(watched, run, resume=True, payload={"middle": 3.0})
    with pytest.raises(InputError, match="arm left gets another load too"):
        collect_by(watched, run, resume=True, payload={"right": run.profile.arms["right"].payload.mass})
    assert len(opened) == 1
    collect_by(watched, run, resume=True, payload={"left": 5.0})
    assert opened[1:] == [5.0]
    assert len(run.stops_done()) == STOPS


def test_a_controller_that_reports_another_payload_is_not_driven(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    heavy = list[float]()
    moved = list[str]()

    @contextmanager
    def forgetful(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options) as cell:
            left, mass = cell.arms["left"], profile.arms["left"].payload.mass
            state = left.state

            def says() -> ArmState:
                return replace(state(), payload_kg=0.3)

            if mass > 1.0:
                heavy.append(mass)
                monkeypatch.setattr(left, "state", says)
                monkeypatch.setattr(left, "start_move", lambda *way: moved.append("left"))
            yield cell

    with pytest.raises(HardwareError, match=r"arm left: not moved with 5 kg: .* set to 0.300 kg"):
        collect_by(forgetful, run)
    assert heavy == [5.0]
    assert moved == []
    assert run.stops_done() == {0, 1, 2}


def test_a_controller_that_does_not_answer_after_a_load_was_hung_is_a_fault_in_words() -> None:
    with open_cell(loaded(HEAVY)) as cell:
        left = cell.arms["left"]
        assert isinstance(left, SimulatedArm)
        left.cut_link()
        with pytest.raises(HardwareError, match="arm left"):
            known_payload(left, 5.0)


def test_a_stop_measured_again_needs_its_own_load(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    collect_run(run)
    by_person(monkeypatch)
    asked = list[str]()
    collect_run(run, again=[1, 4], hung=answers(asked, hangs=True))
    first = run.profile.arms["left"].payload.mass
    assert [f"hang {kg:g} kg" in words for kg, words in zip((first, 5.0), asked, strict=True)] == [True, True]
    left = sure(run.readings("left").payload_kg)
    assert left.tolist() == [first] * 3 + [5.0] * 3


def test_a_damaged_plan_names_what_does_not_fit(run: RunFile) -> None:
    run.profile = loaded()
    with pytest.raises(InputError, match="it tells of load 1, the profile has 0 to 0"):
        read_planned_stops(run)


@pytest.mark.parametrize("text", ["5", "left=", "left=five", "left=inf", "left=5;right=3"])
def test_payloads_that_cannot_be_read_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="--payload"):
        CollectRequest(folder=Path("run"), payload=text)
    assert CollectRequest(folder=Path("run"), payload="left=5, right=3").payloads == {"left": 5.0, "right": 3.0}


@pytest.mark.parametrize(
    ("asked", "carried_kg"),
    [
        ([("left", 5.0), ("left", None), ("right", 0.2)], 5.0),
        ([("left", 4.98)], 5.0),
        ([("left", 5.0), ("left", 0.3)], 0.3),
        ([("left", 2.0)], 0.3),
        ([], 0.3),
    ],
)
def test_a_cell_is_opened_with_the_listed_load_that_all_commands_of_an_arm_are_for(
    asked: list[tuple[str, float | None]], carried_kg: float
) -> None:
    profile = loaded(HEAVY)
    found = carrying(profile, asked)
    assert found.arms["left"].payload.mass == carried_kg
    assert found.arms["right"].payload == profile.arms["right"].payload
    with open_cell(found) as cell:
        assert known_payload(cell.arms["left"], carried_kg) == ""
        assert known_payload(cell.arms["left"], 7.0).startswith("the payload of its controller")


def test_an_arm_that_is_said_twice_to_carry_something_is_refused() -> None:
    with pytest.raises(ValueError, match="arm left is there twice, with 5 and 3 kg"):
        CollectRequest(folder=Path("run"), payload="left=5,left=3")
