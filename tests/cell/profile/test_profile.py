"""The profile door: good profiles come through unchanged, every bad one is refused in a sentence that says where."""

from __future__ import annotations

import math
import os
import re
import shutil
from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile, profile_from_json, profile_to_json
from cellapp.cell.profile.loader import explained
from cellapp.ground.errors import InputError
from cellapp.ground.profile.sections import Traceability
from tests.approved import assert_refused
from tests.sure import sure

PROFILES = Path(__file__).parents[3] / "profiles"
SHIPPED = sorted(PROFILES.glob("*.yaml"))


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    """A copy of the simulated cell that a test may spoil."""
    shutil.copytree(PROFILES, tmp_path / "profiles")
    return tmp_path / "profiles" / "twin.yaml"


def edit(path: Path, old: str, new: str) -> int:
    """Replace the first ``old``, which must be there; the line of the replacement."""
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    return text[: text.index(old)].count("\n") + 1


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_profile(path)
    return str(caught.value)


def test_there_are_profiles() -> None:
    assert {path.stem for path in SHIPPED} >= {"twin", "ur10-ur5", "ur10-real", "ur10-real-d", "ur5-real"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_profiles_load_and_survive_json_exactly(path: Path) -> None:
    profile = load_profile(path)
    text = profile_to_json(profile)
    assert profile_from_json(text) == profile
    assert profile_to_json(profile_from_json(text)) == text


DIFFERENCES = """\
extends: twin.yaml
name: mine
arms: {left: {driver: {kind: ur, host: 127.0.0.9}}}
plan: {stops: 90}
tolerances: null
"""


def test_a_profile_stands_as_differences_to_another_and_every_value_says_where_it_is_from(twin: Path) -> None:
    path = twin.with_name("mine.yaml")
    path.write_text(DIFFERENCES, "utf-8")
    profile, base = load_profile(path), load_profile(twin)
    assert (profile.name, profile.plan.stops, profile.arms["left"].driver.kind) == ("mine", 90, "ur")
    assert profile.tolerances == type(profile.tolerances)() != base.tolerances
    assert (profile.arms["right"], profile.plan.clearance) == (base.arms["right"], base.plan.clearance)
    origins = {key: Path(origin).name for key, _, origin in explained(path)}
    assert (origins["plan.stops"], origins["plan.clearance"].split(":")[0]) == ("mine.yaml:4", "twin.yaml")
    assert (origins["plan.reserve"], origins["arms.left.type.model"].split(":")[0]) == ("default", "ur10.yaml")
    path.write_text("extends: twin\nname: mine\n", "utf-8")  # the one that comes with the program
    assert load_profile(path).arms == base.arms


@pytest.mark.parametrize(
    ("base", "says"), [("none.yaml", "no such profile: none.yaml"), ("mine.yaml", "mine.yaml extends this profile")]
)
def test_a_profile_that_cannot_be_extended_is_named_with_its_line(twin: Path, base: str, says: str) -> None:
    path = twin.with_name("mine.yaml")
    path.write_text(f"name: mine\nextends: {base}\n", "utf-8")
    assert f"mine.yaml:2: extends: {says}" in refusal(path)


def test_an_arm_that_the_extended_profile_lacks_is_named(twin: Path) -> None:
    path = twin.with_name("mine.yaml")
    path.write_text("extends: twin.yaml\nname: mine\narms:\n  lfet: {home: null}\n", "utf-8")
    assert "mine.yaml:4: arms.lfet: no such arm in twin.yaml, whose arms are left, right" in refusal(path)


def test_wrong_values_are_named_with_file_line_and_key_as_approved(tmp_path: Path) -> None:
    """Words of the twin's profile are replaced, or of the file of an arm type where one is named first."""

    def refused(*words: str) -> str:
        shutil.rmtree(tmp_path)
        shutil.copytree(PROFILES, tmp_path)
        *arm_type, old, new = words
        edit(Path(tmp_path, *(["arms", *arm_type] if arm_type else ["twin.yaml"])), old, new)
        said = refusal(tmp_path / "twin.yaml").replace("\0", "\\0")
        return re.sub(r"not YAML: .*", "not YAML: ...", said)  # in words of the parser

    assert_refused(Path(__file__).parent / "approved" / "wrong-values.txt", refused, tmp_path)


def test_a_key_of_another_program_in_every_row_is_told_once(twin: Path) -> None:
    ur10 = twin.parent / "arms" / "ur10.yaml"
    ur10.write_text(ur10.read_text("utf-8").replace("- {d:", "- {offset: 0.0, d:"), "utf-8")
    message = refusal(twin)
    assert "\n" not in message
    assert message.endswith("joints[0].offset: unknown key; did you mean 'theta'?")


def test_an_arm_type_may_stand_in_the_profile(twin: Path) -> None:
    edit(twin, "type: arms/ur10.yaml", "type: {model: two, joints: [{d: 0.1}, {a: 200 mm}]}")
    edit(twin, 'home: [0.0, "-90 deg", 0.0, "-90 deg", 0.0, 0.0]', "home: [0, 0]")
    profile = load_profile(twin)
    assert profile.arms["left"].type.model == "two"
    assert profile.arms["left"].type.joints[1].a == pytest.approx(0.2)
    line = edit(twin, "{model: two,", "{model: two, maker: x,")
    assert refusal(twin).startswith(f"{twin}:{line}: arms.left.type.maker: unknown key")


def test_several_errors_one_a_line_in_the_order_of_the_file(twin: Path) -> None:
    wrong = [("stops: 400", "stops: x"), ("robust: none", "robust: yes"), ("simulations: 400", "simulations: 1")]
    for old, new in wrong:
        edit(twin, old, new)
    lines = refusal(twin).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["plan.stops", "calibration.robust", "discovery.null_simulations"]


@pytest.mark.parametrize(
    ("content", "line", "says"),
    [
        (b"", None, "the file is empty"),
        (b"# only a comment\n", None, "the file is empty"),
        (b"- a\n- b\n", 1, "expected keys with values at the top, got a list"),
        (b"just words\n", 1, "expected keys with values at the top, got 'just words'"),
        (b"schema: cellapp-profile\nname: \xff\xfe\n", 2, "not UTF-8 text"),
        (b"schema: cellapp-profile\nname: [1, 2\nseed: 3\n", 3, "not YAML"),
        (b"schema: x\n\tname: y\n", 2, "not YAML"),
        (b"schema: x\nname: \x07\n", 2, "not YAML"),
        (b"a: &a [*a]\n", 1, "nested too deeply"),
        (b"a: *nothing\n", 1, "not YAML: found undefined alias 'nothing'"),
        (b"a: @b\n", 1, "not YAML: found character '@' that cannot start any token"),
        (b'a: "\\q"\n', 1, "not YAML: found unknown escape character 'q'"),
        (b"a:\n- [b: c: d]\n", 2, "not YAML: expected ',' or ']', but got ':'"),
        (b'a: "\\ud800"\n', 1, "a: half a character"),
        (b"a: " + b"[" * 2000, None, "nested too deeply"),
        (b"a: &a [x,x,x,x,x,x,x,x,x,x]\n" + b"".join(
            b"%c: &%c [%s]\n" % (letter, letter, b",".join([b"*%c" % (letter - 1)] * 10)) for letter in b"bcdefgh"
        ), None, "more than 300000 values"),
        (b"version: 99\nbrand: new\n", 1, "install a newer cellapp"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_profile(tmp_path: Path, content: bytes, line: int | None, says: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    message = refusal(path)
    assert message.startswith(f"{path}:{line}: " if line else f"{path}:")
    assert says in message
    assert "\n" not in message
    assert path.read_bytes() == content


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    assert "file not found" in refusal(tmp_path / "none.yaml")
    assert "cannot be read" in refusal(tmp_path)


def test_simulated_drivers_need_a_plant(twin: Path) -> None:
    text = twin.read_text("utf-8")
    twin.write_text(text[: text.index("# The true simulated cell")], "utf-8")
    assert "plant: simulated drivers need a section 'plant'" in refusal(twin)


def test_short_forms_of_numbers(twin: Path) -> None:
    """YAML 1.1 would leave 1e-8 and 9.0e4 as texts."""
    edit(twin, "robust: none", "tolerance: 1e-9\n  robust: none")
    edit(twin, "[9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]", "[9.0e4, .inf, 1e5, 2E+4, .5e5, -1e-3]")
    profile = load_profile(twin)
    assert profile.calibration.tolerance == 1e-9
    stiffness = sure(profile.plant).effects["left"]["joint_compliance"]["stiffness"]
    assert stiffness == [9.0e4, math.inf, 1e5, 2e4, 0.5e5, -1e-3]
    assert profile_from_json(profile_to_json(profile)) == profile


@pytest.mark.parametrize("text", ["", "{}", "[1]", "{", '{"schema": "cellapp-profile", "version": 2}'])
def test_stored_text_that_is_no_profile(text: str) -> None:
    with pytest.raises(InputError, match="stored profile: "):
        profile_from_json(text)


def test_keys_that_came_later_do_not_change_the_text_of_earlier_profiles() -> None:
    """Stored results rest on the hash of that text: they would all be out of date."""
    text = profile_to_json(load_profile(PROFILES / "twin.yaml"))
    assert not {"mpe", "client", "procedure", "air_pressure", "relative_humidity"} & set(re.findall(r'"(\w+)":', text))
    stated = load_profile(PROFILES / "twin.yaml").model_copy(
        update={"traceability": Traceability(client="Client Ltd", air_pressure=(1000.0, 1010.0))}
    )
    assert profile_from_json(profile_to_json(stated)) == stated


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputError, match="is a pipe, not a file"):
        load_profile(tmp_path / "pipe.yaml")
