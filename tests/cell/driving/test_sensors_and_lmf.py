"""The weather station and the LMF tracker as a profile names them: opening, collecting, ``doctor``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant, open_cell
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.driving.diagnosis import examine
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from drivers.plant import Plant
from drivers.sensors.protocol import AirReading, SensorLinkLost
from drivers.sensors.simulated import SimulatedAirSensor
from drivers.trackers.lmf import LmfTracker
from tests.approved import assert_refused
from tests.drivers.trackers.fake_lmf import Scene
from tests.sure import sure
from tests.twin import small_twin, write_profile

STOPS = 4


@pytest.fixture(scope="module")
def plan() -> dict[str, np.ndarray]:
    return plan_stops(small_twin(STOPS))


def with_sections(folder: Path, sensors: str = "", driver: str = "") -> Profile:
    """The twin with a section ``sensors`` and another tracker driver, as YAML."""
    path = write_profile(folder)
    text = path.read_text("utf-8").replace("stops: 30", f"stops: {STOPS}")
    if driver:
        assert text.count("driver: {kind: simulated}\n  # 3.8 m") == 1
        text = text.replace("driver: {kind: simulated}\n  # 3.8 m", f"driver: {driver}\n  # 3.8 m")
    path.write_text(f"{text}\nsensors: {sensors}\n" if sensors else text, "utf-8")
    return load_profile(path)


# -- profile ----------------------------------------------------------------------------------------------------------


def test_without_a_section_there_is_no_sensor() -> None:
    assert small_twin().sensors.air is None


def test_bad_sensors_are_refused_at_load(tmp_path: Path) -> None:
    def refused(air: str) -> str:
        with pytest.raises(InputError) as caught:
            with_sections(tmp_path, f"{{air: {air}}}")
        told = str(caught.value)
        assert told.startswith(f"{tmp_path}/twin.yaml:")
        return re.sub(r"\S+/twin\.yaml:\d+: ", "", told)

    assert_refused(Path(__file__).parent / "approved" / "sensors.txt", refused)


# -- collecting -------------------------------------------------------------------------------------------------------


class Station(SimulatedAirSensor):
    """Two degrees warmer than the tracker's own sensor, silent at the stops it is told."""

    silent: tuple[int, ...] = ()

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self.asked = 0

    def read(self) -> AirReading:
        self.asked += 1
        if self.asked in self.silent:
            raise SensorLinkLost("air sensor: it is silent")
        reading = super().read()
        return AirReading(reading.time_s, reading.temperature_c + 2.0, 1000.0, 40.0, object_temperature_c=25.0)


def collected(
    folder: Path, profile: Profile, plan: dict[str, np.ndarray]
) -> tuple[np.ndarray, tuple[str, ...], list[str]]:
    """Temperatures of the left arm's readings, the notes, and the run's log."""
    with RunFile.create(folder / "run", profile) as run:
        run.write_plan(plan)
        notes = collect_run(run).notes
        temperature = sure(run.readings("left").temperature_c)
        return temperature, notes, [event.text for event in run.events()]


def test_the_stations_temperature_goes_with_the_readings(
    tmp_path: Path, plan: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.sensors.simulated.SimulatedAirSensor", Station)
    without, _, _ = collected(tmp_path / "without", with_sections(tmp_path / "a"), plan)
    profile = with_sections(tmp_path / "b", "{air: {kind: simulated}}")
    with_station, _, log = collected(tmp_path / "with", profile, plan)
    assert with_station - without == pytest.approx(np.full(STOPS, 2.0), abs=0.01)
    assert sum("air 2" in line and "1000.0 hPa, 40 %, object 25.0 degC, 0 s old" in line for line in log) == 1


def test_a_silent_station_leaves_a_gap_and_one_note(
    tmp_path: Path, plan: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.sensors.simulated.SimulatedAirSensor", Station)
    monkeypatch.setattr(Station, "silent", (2, 3))
    profile = with_sections(tmp_path / "a", "{air: {kind: simulated}}")
    temperature, notes, _ = collected(tmp_path, profile, plan)
    assert np.isnan(temperature).tolist() == [False, True, True, False]
    assert [note for note in notes if "silent" in note] == [
        "stop 2: readings go without air temperature: air sensor: it is silent"
    ]


def test_a_station_that_cannot_be_opened_stops_before_anything_moves(tmp_path: Path) -> None:
    profile = with_sections(tmp_path, "{air: {kind: serial, url: /dev/there-is-none, format: vaisala-ptu300}}")
    with pytest.raises(HardwareError, match="air sensor /dev/there-is-none: cannot be opened"), open_cell(profile):
        pass


# -- doctor -----------------------------------------------------------------------------------------------------------


def found(profile: Profile, subject: str) -> tuple[str, str]:
    return next((finding.status, finding.text) for finding in examine(profile) if finding.subject == subject)


@pytest.mark.parametrize(
    ("poll", "status", "text"),
    [
        (r"x\r\nT=21.5\r\n", "ok", "loop://: air 21.5 degC, 0 s old"),
        (r"x\r\nT=294.6\r\n", "failed", "is it in another unit than degC?"),
        ("", "failed", "it is silent; check its power"),
    ],
)
def test_doctor_reads_the_station(tmp_path: Path, poll: str, status: str, text: str) -> None:
    """What is sent into a loop comes back."""
    air = f"{{kind: serial, url: 'loop://', pattern: 'T=(?P<temperature>.*)', timeout: 0.5, poll: \"{poll}\"}}"
    found_status, found_text = found(with_sections(tmp_path, f"{{air: {air}}}"), "sensor air")
    assert found_status == status
    assert text in found_text


def test_doctor_says_what_a_simulated_station_is(tmp_path: Path) -> None:
    assert found(with_sections(tmp_path, "{air: {kind: simulated}}"), "sensor air")[0] == "ok"


# -- LMF --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """LMF's stand-in behind the profile's driver, which jobs and the doctor open."""
    scene = Scene(targets={"left": np.array([3.0, 0.4, -0.2])}, network=(("192.168.0.7", "AT960", "750123"),))
    monkeypatch.setattr("drivers.trackers.lmf.LmfTracker", partial(LmfTracker, load=lambda library: scene.lmf()))
    yield scene
    assert scene.violations == []
    assert scene.connected == []


def test_lmf_is_initialised_and_set_up_as_the_profile_says(tmp_path: Path, scene: Scene) -> None:
    driver = (
        "{kind: lmf, address: AT960LRSimulator, reflector: Red Ring, accuracy: precise, serial: '750123',"
        " search_radius: 30 mm, air: {temperature: 22 degC, pressure_hpa: 990.0, humidity_percent: 33.0}}"
    )
    with open_cell(with_sections(tmp_path, driver=driver)) as cell:
        point = cell.tracker.measure(np.array([3.0, 0.4, -0.2]), 1.0)
    assert (point.temperature_c, point.pressure_hpa, point.reflector) == (22.0, 990.0, "RRR 1.5in")
    assert scene.calls.count("Initialize") == 1
    assert scene.persistent["tracker"].TargetSearch.Radius.Value == 0.03
    assert str(scene.persistent["tracker"].Measurement.Profiles.Selected.Accuracy.Value) == "Precise"


def test_lmf_that_is_not_ready_or_not_there(tmp_path: Path, scene: Scene) -> None:
    scene.quick_release = False
    profile = with_sections(tmp_path / "a", driver="{kind: lmf, address: 192.168.0.1}")
    with open_cell(profile) as cell, pytest.raises(HardwareError, match="its quick release is open: close it"):
        cell.require_tracker()
    scene.quick_release = True
    profile = with_sections(tmp_path / "b", driver="{kind: lmf, address: 192.168.0.1, reflector: Cateye}")
    with pytest.raises(InputError, match="none matches 'Cateye'"), open_cell(profile):
        pass


def test_an_unknown_simulator_of_lmf_is_refused_at_load(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"yaml:\d+: tracker\.driver\.address: 'AT961Simulator' is not a simulator"):
        with_sections(tmp_path, driver="{kind: lmf, address: AT961Simulator}")


def test_doctor_asks_lmf_without_moving_the_head(tmp_path: Path, scene: Scene) -> None:
    profile = with_sections(tmp_path / "a", driver="{kind: lmf, address: 192.168.0.1}")
    status, text = found(profile, "tracker")
    assert status == "warning"
    assert text.startswith("AT960-LR, serial 750123, firmware 2.3.0.1; before it measures: Tracker not initialized")
    scene.initialised = True
    assert found(profile, "tracker") == ("ok", "AT960-LR, serial 750123, firmware 2.3.0.1; ready")
    scene.compatible = False
    assert "this LMF was made for 2.3" in found(profile, "tracker")[1]
    assert not {"Initialize", "PositionTo", "Face.Change", "GetInclinationToGravity"} & set(scene.calls)
    status, text = found(with_sections(tmp_path / "b", driver="{kind: lmf, address: 10.0.0.9}"), "tracker")
    assert status == "failed"
    assert text.endswith("LMF sees AT960 750123 at 192.168.0.7")


# -- Collecting more than a point on the simulated cell: a 6-D probe on one flange, one SMR on the other ---------------

STOPS_OF_MORE_THAN_A_POINT = 8
RPY = (0.1, -0.2, 0.3)


def cell_with() -> Profile:
    profile = small_twin(STOPS_OF_MORE_THAN_A_POINT)
    right = profile.arms["right"]
    smr = Smr.model_validate({**right.smr.model_dump(), "probe": {"rpy": RPY, "sigma": 5e-5}})
    return profile.model_copy(update={"arms": {**profile.arms, "right": right.model_copy(update={"smr": smr})}})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    profile = cell_with()
    with RunFile.create(tmp_path_factory.mktemp("more") / "run", profile) as made:
        made.write_plan(plan_stops(profile))
        collect_run(made)
        yield made


def test_a_probe_is_measured_as_it_is_turned(run: RunFile) -> None:
    right = run.readings("right")
    assert right.quaternion_M is not None
    np.testing.assert_array_equal(sure(right.sigma_rad), np.full(STOPS_OF_MORE_THAN_A_POINT, 5e-5))
    true = build_plant(run.profile).probe_rotations(
        "right", right.q, approach=right.approach.astype(np.float64), others={"left": run.readings("left").q}
    )
    off = (Rotation.from_quat(np.roll(right.quaternion_M, -1, axis=1)) * Rotation.from_matrix(true).inv()).as_rotvec()
    assert np.abs(off).max() < 5e-3  # hidden effects of time, rest and warmth are not asked for here
