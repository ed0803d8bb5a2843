"""Touches of sockets are recorded while a person leads the arm; nothing moves, and a wrong name is noticed."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from cellapp.cell.driving.touching import Moving, touch_reader
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.measured_again import replaced_counts
from cellapp.cell.run.touches import touches_before
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.check.run import check_by_touches
from cellapp.commands.touch import run as touch_run
from cellapp.estimation.readings import Reading
from cellapp.ground.errors import CellappError, HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.interfaces.cli.app import app
from drivers.arms.protocol import ArmTimeout, LinkLost
from drivers.arms.ur_settings import UrSettings
from drivers.settings import SettingError
from tests.twin import PROFILES, whole_twin

TWIN = PROFILES / "twin.yaml"
Touch = Callable[..., Result]


@pytest.fixture
def touch(tmp_path: Path) -> Touch:
    """The command on the left arm of the twin, with what is typed."""

    def call(*options: str, typed: Sequence[str] = (), profile: Path = TWIN, arm: str | None = "left") -> Result:
        words = ["touch", str(profile), "--run", str(tmp_path / "touched"), *options]
        words += [] if arm is None else ["--arm", arm]
        return CliRunner().invoke(app, words, input="".join(f"{line}\n" for line in typed))

    return call


def led_to(monkeypatch: pytest.MonkeyPatch, sockets: Sequence[str | Exception]) -> None:
    """Let the person lead the arm to these sockets one after the other, whatever name is typed."""
    lead, waiting, counts = touch_reader(whole_twin(), "left"), list(sockets), dict[str, int]()

    def read(point: str, before: int) -> Reading:
        socket = waiting.pop(0)
        if isinstance(socket, Exception):
            raise socket
        counts[socket] = counts.get(socket, 0) + 1
        its = lead(socket, counts[socket])
        return Reading(q=its.q, p_M=its.p_M, payload_kg=its.payload_kg, approach=its.approach, point=point)

    monkeypatch.setattr(touch_run, "touch_reader", lambda profile, arm: read)


def refused(result: Result, words: str, code: int = 2) -> None:
    """Whether the command ended with this sentence, which the program prints, and the exit code."""
    assert isinstance(result.exception, CellappError), result.output
    assert words in str(result.exception)
    assert result.exception.exit_code == code


def test_lines_are_recorded_undone_and_gone_on_with(touch: Touch, tmp_path: Path) -> None:
    said = touch(typed=["front_0", "", "front_1", "undo", "front_1", "end", "never read"])
    assert said.exit_code == 0
    assert "recorded: 2 touches of 'front_0', agree to" in said.stdout
    assert "the touch of 'front_1' (configuration 2) was taken back" in said.stdout
    assert "3 touches recorded" in said.stdout, "the one that was taken back does not count"
    assert "touched once, which says nothing yet: front_1" in said.stdout
    result = json.loads(touch("--point", "front_1", "--json", "-").stdout)
    assert result["recorded"] == [{"configuration": 3, "point": "front_1"}]
    assert [(one["point"], one["touches"]) for one in result["points"]] == [("front_0", 2), ("front_1", 2)]
    with RunFile.open(tmp_path / "touched") as run:
        its = run.rows("left")
        assert replaced_counts(run) == {"left": 1}, "what rests on the touch that was taken back is out of date"
    assert its.point == ("front_0", "front_0", "front_1", "front_1")
    assert np.isnan(its.p_M).all()
    assert not its.approach.any(), "how the joints came there by hand is unknown"
    assert its.payload_kg is not None
    assert its.payload_kg == pytest.approx(whole_twin().arms["left"].payload.mass)
    assert np.all(np.diff(its.time_s) >= 0.0)


def test_a_wrong_name_is_asked_about(touch: Touch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    led_to(monkeypatch, [*["far"] * 3, *["near"] * 4, "near"])
    said = touch(typed=["far"] * 3 + ["near"] * 3 + ["far", "no", "far", "yes"])
    assert "from the others of 'far' by the published arm; it lies" in said.output
    assert "mm from 'near'. Record it as 'far' all the same? yes or no:" in said.output
    with RunFile.open(tmp_path / "touched") as run:
        assert run.rows("left").point == (*["far"] * 3, *["near"] * 3, "far")
    led_to(monkeypatch, ["near"])
    refused(touch("--point", "far"), "nothing was recorded. Correct the name, or insist with --sure")
    led_to(monkeypatch, ["near"])
    assert touch("--point", "far", "--sure").exit_code == 0


@pytest.mark.fast
def test_an_arm_that_moves_or_is_lost_is_not_recorded(
    touch: Touch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    led_to(monkeypatch, [Moving("arm left: the arm moves"), HardwareError("arm left: the link is lost"), "a", "a"])
    refused(touch("--point", "a"), "the arm moves")
    refused(touch("--point", "a"), "the link is lost", code=3)
    assert not (tmp_path / "touched").exists()
    led_to(monkeypatch, [HardwareError("arm left: the link is lost")])
    refused(touch(typed=["a"]), "the link is lost", code=3)
    led_to(monkeypatch, [Moving("arm left: the arm moves"), "a"])
    said = touch(typed=["a", "a"])
    assert (said.exit_code, "the arm moves" in said.stdout) == (0, True)
    assert "recorded: 1 touch of 'a'" in said.stdout


@pytest.mark.fast
def test_the_same_posture_again_is_said(touch: Touch, monkeypatch: pytest.MonkeyPatch) -> None:
    still = touch_reader(whole_twin(), "left")("a", 0)
    monkeypatch.setattr(touch_run, "touch_reader", lambda profile, arm: lambda point, before: still)
    assert "the joints stand as before, which says nothing" in touch(typed=["a", "a"]).stdout


@pytest.mark.fast
@pytest.mark.parametrize(
    ("raised", "kind"),
    [
        (ArmTimeout("it moves"), Moving),
        (LinkLost("no state"), HardwareError),
        (SettingError("driver: cannot be read"), InputError),
    ],
)
def test_what_a_driver_says_names_the_arm(
    monkeypatch: pytest.MonkeyPatch, raised: Exception, kind: type[CellappError]
) -> None:
    def read_at_rest(settings: object, arm: object, rest_s: float, patience_s: float) -> NoReturn:
        raise raised

    monkeypatch.setattr(UrSettings, "read_at_rest", read_at_rest)
    read = touch_reader(load_profile(PROFILES / "ur10-ur5.yaml"), "left")
    with pytest.raises(kind, match=r"^arms?[ .]left[:.]"):
        read("a", 0)


def test_bad_inputs_are_refused(touch: Touch, tmp_path: Path) -> None:
    refused(touch("--point", " "), "the name of the socket is empty")
    refused(touch("--point", "undo"), "it is a word of this command")
    refused(touch("--point", "x" * 61), "at most 60 printable characters")
    refused(touch("--point", "a", "--undo"), "leave the name out to take the last touch back")
    refused(touch("--sure"), "--sure belongs to --point")
    refused(touch("--on-flange", "--distances", "known.csv"), "--distances are between sockets that stand still")
    refused(touch("--point", "a", arm="third"), "arm 'third' is not in the profile; arms are left, right")
    refused(touch("--point", "a", arm=None), "say which arm is led; arms are left, right")
    refused(touch("--undo"), "there is no touch of arm left to take back")
    refused(touch(typed=[""]), "the name of the socket is empty")
    panda = PROFILES / "panda-sockets.yaml"
    refused(touch("--point", "a", profile=panda), "kind 'none' has no device to read")
    assert not (tmp_path / "touched").exists(), "nothing was recorded, so there is no run"
    assert touch("--point", "a").exit_code == 0
    refused(touch("--point", "a", profile=panda), "the run was begun with another profile")
    (tmp_path / "d.csv").write_text("point_a,point_b,distance_m,sigma_m\na,b,0.05,0.0001\n")
    refused(touch("--distances", str(tmp_path / "d.csv")), "no reading is of a point 'b'")


def test_a_run_of_a_tracker_takes_no_touches(finished_copy: Path) -> None:
    called = CliRunner().invoke(app, ["touch", str(TWIN), "--run", str(finished_copy), "--arm", "left"])
    refused(called, "give")
    with RunFile.open(finished_copy) as run, pytest.raises(InputError, match="plan for a tracker"):
        touches_before(finished_copy, run.profile, "left")


def use(profile: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command read this profile."""
    monkeypatch.setattr(touch_run, "load_profile", lambda path: profile)


def test_recorded_touches_calibrate(touch: Touch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = whole_twin()
    assert twin.plant is not None
    plant = twin.plant.model_copy(update={"effects": {}})
    use(twin.model_copy(update={"arms": {"left": twin.arms["left"]}, "plant": plant}), monkeypatch)
    (tmp_path / "d.csv").write_text("point_a,point_b,distance_m,sigma_m\nfront_0,front_1,0.05,0.00005\n")
    typed = [name for name in ("front_0", "front_1", "back_0", "side_0", "high_0") for _ in range(7)]
    said = touch("--distances", str(tmp_path / "d.csv"), typed=typed, arm=None)
    assert "35 touches recorded" in said.stdout
    assert "are stored" in said.stdout
    with RunFile.open(tmp_path / "touched", write=True) as run:
        assert run.rows("left").distances[0].distance_m == 0.05
        held_out = calibrate_run(run).arms["left"].validate_
    assert held_out["geometry"].position_mm.mean < 0.2 * held_out["nominal"].position_mm.mean


def test_recorded_touches_check_a_calibration(
    touch: Touch, tmp_path: Path, finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        use(run.profile, monkeypatch)
        assert touch(typed=["nest"] * 10).exit_code == 0
        found = check_by_touches(run, tmp_path / "touched")
        assert len(found.stops) == 10
        assert found.verdict in ("valid", "cannot say")
        with pytest.raises(InputError, match="needs points"):
            check_by_touches(run, finished_copy)
