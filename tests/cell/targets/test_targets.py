"""Target lists: what is read and what is refused, in words that name the file and the target."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.prediction import _with_noise, length_bounds
from cellapp.cell.targets.targets import load_targets
from cellapp.ground.errors import InputError
from cellapp.robot.model import CellModel
from cellapp.robot.model.model import PosteriorSamples, ReadingsNoise
from tests.approved import assert_refused
from tests.twin import PROFILES, small_twin

PROFILE = small_twin()
HEAD = "schema: cellapp-targets\nversion: 1\ntargets:\n"
GOOD = "  - {name: one, arm: left, position: [-0.4, 0.25, 1.0], rpy: [0, 0, 0]}\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "targets.yaml"


def test_units_and_order(path: Path) -> None:
    path.write_text(HEAD + GOOD + '  - {name: two, arm: right, position: ["250 mm", 0, 1], rpy: ["90 deg", 0, 0]}\n')
    one, two = load_targets(path, PROFILE)
    assert (one.name, one.arm, one.position) == ("one", "left", (-0.4, 0.25, 1.0))
    assert (two.position, two.rpy) == ((0.25, 0.0, 1.0), (math.pi / 2.0, 0.0, 0.0))


def test_what_is_refused(path: Path) -> None:
    """Words of a good list are replaced, ALL of it, or its only target, which is called GOOD."""

    def refused(old: str, new: str) -> str:
        old, new = (word.replace("GOOD", GOOD) for word in (old, new))
        path.write_text(new if old == "ALL" else (HEAD + GOOD).replace(old, new, 1))
        with pytest.raises(InputError) as told:
            load_targets(path, PROFILE)
        message = str(told.value).replace(f"{path.parent}/", "")
        return re.sub(r"not YAML: .*", "not YAML: ...", message)  # in words of the parser

    assert_refused(Path(__file__).parent / "approved" / "refused-files.txt", refused)


def test_no_file_a_folder_and_no_text(path: Path) -> None:
    with pytest.raises(InputError, match="file not found"):
        load_targets(path, PROFILE)
    with pytest.raises(InputError, match="cannot be read"):
        load_targets(path.parent, PROFILE)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8 text"):
        load_targets(path, PROFILE)


# -- The example lists of the twin: they load and can be compensated --------------------------------------------------

EXAMPLES = ("twin-table.csv", "twin-fixture.yaml")


def test_the_examples_show_every_frame_and_both_arms() -> None:
    listed = [target for name in EXAMPLES for target in load_targets(PROFILES / "targets" / name, small_twin())]
    assert {target.frame for target in listed} == {"base", "tracker", "left", "right", "plate", "edge"}
    assert sum(target.partner is not None for target in listed) == 2
    assert sum(target.rpy is None for target in listed) == 1
    assert all(target.conditions.payload == 0.3 for target in listed if target.name.startswith(("hole", "pair")))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_compensated(run: RunFile, model: CellModel, name: str) -> None:
    listed = load_targets(PROFILES / "targets" / name, run.profile)
    commands = compensate(run.profile, model, listed)
    assert [(command.target.name, command.record.arm) for command in commands] == [
        (target.name, arm) for target in listed for arm in target.arms
    ]
    refused = {f"{one.name} {one.arm}": one.refusal for one in (its.record for its in commands) if one.refusal}
    assert not refused


# -- The bound of a measured rotation, where its noise differs by axis -------------------------------------------------

AXES = np.array([5e-5, 6e-5, 2e-4])
SAMPLES = PosteriorSamples((0,), np.zeros((4, 1)), (), ReadingsNoise(1e-5, float(np.sqrt(np.mean(AXES**2))), AXES))


def test_angles_of_several_smrs_keep_their_bound() -> None:
    rng = np.random.default_rng(1)
    rotations = Rotation.random(4000, random_state=2)
    angles = np.linalg.norm(rotations.apply(AXES * rng.standard_normal((4000, 3))), axis=1)
    true = 1e-12 * np.eye(3)[None]
    by_axis = length_bounds(_with_noise(true, SAMPLES))[1][0]
    without_axes = replace(SAMPLES, noise=SAMPLES.noise._replace(axes_rad=None))
    alike = length_bounds(_with_noise(true, without_axes))[1][0]
    assert np.mean(angles <= by_axis) == pytest.approx(0.95, abs=0.012)
    assert np.mean(angles <= alike) < 0.94
