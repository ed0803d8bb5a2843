"""Target lists: what is read and what is refused, in words that name the file and the target."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from cellapp.compensation.targets import load_targets
from cellapp.errors import InputError
from tests.twin import PROFILES, small_twin

pytestmark = pytest.mark.fast

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


def test_the_list_of_the_twin() -> None:
    targets = load_targets(PROFILES / "targets" / "twin.yaml", PROFILE)
    assert [sum(target.arm == arm for target in targets) for arm in ("left", "right")] == [20, 20]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file: "),
        ("- 1\n", "the file: "),
        ("schema: cellapp-targets\nversion: 1\ntargets: []\n", "targets: "),
        ("schema: cellapp-targets\nversion: 1\ntargets:\n", "targets: expected a list, got nothing"),
        ("schema: something\nversion: 1\ntargets:\n" + GOOD, "schema: expected 'cellapp-targets', got 'something'"),
        ("schema: cellapp-targets\nversion: 2\ntargets:\n" + GOOD, "version: expected 1, got 2"),
        (HEAD + GOOD.replace("left", "middle"), "target 'one': no arm 'middle'; arms are left, right"),
        (HEAD + GOOD + GOOD, "target 'one' is listed twice; give every target its own name"),
        (HEAD + GOOD.replace("0.25", ".nan"), "targets.0.position.1: "),
        (HEAD + GOOD.replace("0.25", ".inf"), "targets.0.position.1: "),
        (HEAD + GOOD.replace("0.25", "250"), "targets.0.position.1: 250 m is beyond 100 m"),
        (HEAD + GOOD.replace("0.25", "'250 deg'"), "targets.0.position.1: 'deg' is not a unit of length"),
        (HEAD + GOOD.replace("rpy: [0, 0, 0]", "rpy: [90, 0, 0]"), "targets.0.rpy.0: 90 rad is more than two turns"),
        (HEAD + GOOD.replace("rpy: [0, 0, 0]", "rpy: [0, 0]"), "targets.0.rpy.2: "),
        (HEAD + GOOD.replace(", rpy: [0, 0, 0]", ""), "targets.0.rpy: missing; it must be given"),
        (HEAD + GOOD.replace("[0, 0, 0]", "[x, 0, 0]"), "targets.0.rpy.0: expected an angle: a number in rad"),
        (HEAD + GOOD.replace("rpy", "rpx"), "targets.0.rpy: "),
        (HEAD + GOOD.replace("name: one", "name: 1"), "targets.0.name: "),
        (HEAD + "  - {name: one, arm: [left\n", ":5: not YAML: "),
        (HEAD + "  - !!python/object/apply:os.system ['true']\n", ":4: not YAML: "),
    ],
)
def test_what_is_refused(path: Path, text: str, says: str) -> None:
    path.write_text(text)
    with pytest.raises(InputError) as told:
        load_targets(path, PROFILE)
    message = str(told.value)
    assert message.startswith(str(path))
    assert says in message
    assert "\n" not in message


def test_no_file_a_folder_and_no_text(path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_targets(path, PROFILE)
    with pytest.raises(InputError, match="cannot be read"):
        load_targets(path.parent, PROFILE)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8 text"):
        load_targets(path, PROFILE)
