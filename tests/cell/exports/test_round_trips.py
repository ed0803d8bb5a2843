"""Each file, read by a program apart from cellapp, gives the model's geometry within a micrometre."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cellapp.cell.exports.arm_export import ArmExport, conversion_mm
from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.formats import formats_of
from cellapp.cell.exports.urdf import kinematics_hash, murmur
from cellapp.cell.profile import load_profile
from cellapp.cell.profile.controller_file import controller_file_text, controller_table
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import ArmType
from cellapp.ground.profile.sections import ControllerTable
from cellapp.robot.kinematics.chain import Geometry, plain_geometry, smr_positions
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import controller_rows, nominal_arm
from drivers.emulators.ur_controller import personality
from tests.arms import OFF_AXIS, at_station, dh, true_geometry
from tests.cell.exports import readers
from tests.drivers.arms.test_ur_probe import ask, emulated
from tests.twin import altered

FORMATS = formats_of(ExportFormat)

Array = NDArray[np.float64]
PROFILES = Path(__file__).parents[3] / "profiles"
SAME_CHAIN = {"ur3e", "ur5e", "ur16e", "ur20"}
"""Types with the chain of the ur10e."""
TYPES = {
    path.stem: ArmType.model_validate(yaml.safe_load(path.read_text("utf-8")))
    for path in PROFILES.glob("arms/**/*.yaml")
    if path.stem not in SAME_CHAIN
}
TWIN = load_profile(PROFILES / "twin.yaml")
UR = {name for name in TYPES if name.startswith("ur")}
BAR_M = 1e-6
POSES = 1000


def published(name: str) -> Array:
    return np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in TYPES[name].joints])


def export_of(name: str, geometry: Geometry, nominal: Geometry) -> ArmExport:
    arm = TWIN.arms["left"].model_copy(update={"type": TYPES[name], "limits": None})
    joints = TYPES[name].joints
    masses, centers = [joint.mass for joint in joints], [joint.center_of_mass for joint in joints]
    bodies = Bodies(np.array(masses), np.array(centers), 0.0, np.zeros(3))
    model = ArmModel(geometry, nominal, bodies, np.array([0.0, 0.0, 1.0]))
    q = np.random.default_rng(1).uniform(-2.0 * np.pi, 2.0 * np.pi, (POSES, geometry.joints))
    return ArmExport("left", arm, model, "a test", q, {}, None)


def drawn(name: str, seed: int, length: float = 0.3e-3, angle: float = 0.9e-3) -> ArmExport:
    nominal = at_station(published(name), OFF_AXIS)
    return export_of(name, true_geometry(nominal, np.random.default_rng(seed), length, angle), nominal)


def _published_rows(export: ArmExport) -> Array:
    return export.model.nominal.rows[:, :4]


READERS: Mapping[str, Callable[[ArmExport, str, Array], Array]] = {
    "ur-calibration": lambda export, text, smr: readers.ur_controller(text, _published_rows(export), smr, export.q),
    "ur-description": lambda export, text, smr: readers.ur_description(text, smr, export.q),
    "urdf": lambda export, text, smr: readers.urdf(text, export.name, export.q),
    "dh": lambda export, text, smr: readers.dh(text, export.q),
    "dh-plain": lambda export, text, smr: readers.dh(text, export.q),
    "poe": lambda export, text, smr: readers.poe(text, export.q),
    "parameters": lambda export, text, smr: readers.parameters(text, export.q),
}
IN_BASE = ("ur-calibration", "ur-description")
"""Files without the tracker: their positions are in the base frame."""


def off_m(export: ArmExport, form: str) -> float:
    """Largest distance [m] between what the reader of a format computes and the model's geometry."""
    text = FORMATS[form].text(export, ["a sentence --- with hyphens --"])
    geometry = export.geometry.with_T_M_B(np.eye(4)) if form in IN_BASE else export.geometry
    found = READERS[form](export, text, FORMATS[form].smr(export))
    return float(np.linalg.norm(found - smr_positions(geometry, export.q), axis=1).max())


CASES = [(arm, form) for arm in sorted(TYPES) for form in FORMATS if arm in UR or not form.startswith("ur-")]


@pytest.mark.parametrize(("arm", "form"), CASES)
def test_a_file_that_is_read_back_is_the_same_arm(arm: str, form: str) -> None:
    for seed in range(3):
        export = drawn(arm, seed)
        assert off_m(export, form) < BAR_M


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=12)
@given(
    arm=st.sampled_from(sorted(TYPES)),
    seed=st.integers(0, 2**32 - 1),
    length=st.floats(-7.0, -2.0).map(lambda power: 10.0**power),
    angle=st.floats(-12.0, -1.0).map(lambda power: 10.0**power),
)
def test_any_geometry_survives_the_way_out_and_back(
    form: str, arm: str, seed: int, length: float, angle: float
) -> None:
    export = drawn(arm if arm in UR or not form.startswith("ur-") else "ur10", seed, length, angle)
    export = replace(export, q=export.q[:50])
    assert off_m(export, form) < BAR_M


def test_numbers_as_the_controller_writes_them() -> None:
    """Eighteen digits and tens of metres, as in the file of a real arm; nine digits would lose what was measured."""
    export = drawn("ur10", 0)
    text = FORMATS["ur-calibration"].text(export, ["from here"])
    assert text.startswith("# from here\n")
    for name, place in (("d", 1), ("a", 2), ("alpha", 3)):
        assert f"#   {name} = {_published_rows(export)[:, place].tolist()}\n" in text
    values = [line for line in text.splitlines() if line.startswith("delta_")]
    assert [line.split(" = ")[0] for line in values] == ["delta_theta", "delta_a", "delta_d", "delta_alpha"]
    deltas = [float(value) for value in values[2].split("[")[1].rstrip("]").split(",")]
    assert max(np.abs(deltas)) > 10.0
    assert abs(sum(deltas[1:4])) < 5e-3, "the large ones cancel"
    rounded = replace(plain_geometry(export.geometry))
    rounded.rows[:] = np.vectorize(lambda value: float(f"{value:.9g}"))(rounded.rows)
    assert 1e-10 < conversion_mm(export, plain_geometry(export.geometry)) < 1e-6
    assert conversion_mm(export, rounded) > 1e-5


def test_a_plain_table_has_no_hayati_angle() -> None:
    assert ["beta:" in FORMATS[form].text(drawn("ur10", 0), []) for form in ("dh", "dh-plain")] == [True, False]


def test_the_hash_is_that_of_the_published_description() -> None:
    """``config/ur10e/default_kinematics.yaml`` of UR's ur_description has this hash for this table."""
    right = 1.570796327
    d, a = [0.1807, 0, 0, 0.17415, 0.11985, 0.11655], [0, -0.6127, -0.57155, 0, 0, 0]
    rows = dh([0.0] * 6, d, a, [right, 0, 0, right, -right, 0])
    assert kinematics_hash(rows) == "calib_5119701370761913513"
    # what std::hash<std::string> of GNU C++ 12 gives for a text that is no multiple of eight bytes
    assert murmur(b"0.1807abc") == 13121897349359385684
    export = drawn("ur10", 0)
    text = FORMATS["ur-description"].text(export, [])
    assert [text.count(words) for words in ("SMR in tool0", "SMR in the flange", "Base in the tracker")] == [1, 0, 1]
    found = yaml.safe_load(text)["kinematics"]
    controller = readers.ur_table(FORMATS["ur-calibration"].text(export, []), _published_rows(export))
    assert found["hash"] == kinematics_hash(controller)


@pytest.mark.parametrize("form", ["ur-calibration", "ur-description"])
@pytest.mark.parametrize("arm", sorted(set(TYPES) - UR))
def test_an_arm_of_another_make_is_refused(arm: str, form: str) -> None:
    with pytest.raises(InputError, match=r"does not have the chain of a UR arm.*nothing was written\. Take urdf"):
        FORMATS[form].text(drawn(arm, 0), [])


def test_an_arm_with_one_other_angle_is_refused() -> None:
    arm = drawn("ur10", 0).arm
    first, *others = arm.type.joints
    export = replace(
        drawn("ur10", 0), arm=altered(arm, type={"joints": (first.model_copy(update={"alpha": 1.2}), *others)})
    )
    with pytest.raises(InputError, match="does not have the chain of a UR arm"):
        FORMATS["ur-calibration"].text(export, [])


def test_urdf_has_limits_speeds_masses_and_their_places() -> None:
    export = drawn("elbow-antiparallel", 0)
    model = pinocchio.buildModelFromXML(FORMATS["urdf"].text(export, []))
    joints = TYPES["elbow-antiparallel"].joints
    np.testing.assert_allclose(model.lowerPositionLimit, [joint.limit[0] for joint in joints])
    np.testing.assert_allclose(model.upperPositionLimit, [joint.limit[1] for joint in joints])
    np.testing.assert_allclose(model.velocityLimit, [joint.speed for joint in joints])
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(sum(joint.mass for joint in joints))
    data, own = model.createData(), export.geometry.rows
    for q in export.q[:20]:
        moments = np.zeros(3)
        for place, joint in enumerate(joints):
            T = export.geometry.T_M_B() @ readers.rows_chain(own[: place + 1], q[None, : place + 1])
            moments += joint.mass * readers.points(T, np.array(joint.center_of_mass))[0]
        center = pinocchio.centerOfMass(model, data, q)
        np.testing.assert_allclose(center, moments / sum(joint.mass for joint in joints), atol=1e-9)


def test_a_controller_that_holds_the_file_computes_by_the_calibrated_rows() -> None:
    """Out as a file, into an emulated controller, over its primary interface back into a profile."""
    export = drawn("ur10", 3)
    text = FORMATS["ur-calibration"].text(export, ["from here"])
    table = ControllerTable.model_validate(controller_table(text, Path("left.conf")))
    arm = export.arm.model_copy(update={"factory": table})
    rows = tuple((theta, d, a, alpha) for theta, d, a, alpha in controller_rows(arm).tolist())
    holds = replace(personality("CB3", "UR10", "20150001"), rows=rows, checksums=(1,) * 6, calibration_status=2)
    with emulated(holds) as emulator:
        kinematics = ask(emulator).kinematics
    assert kinematics is not None
    np.testing.assert_array_equal(kinematics.rows, controller_rows(arm))
    text = controller_file_text((kinematics.rows - controller_rows(export.arm)).tolist(), kinematics.checksum)
    again = ControllerTable.model_validate(controller_table(text, Path("left.conf")))
    assert again.checksum == "-".join(["00000001"] * 6)
    nominal = nominal_arm(arm.model_copy(update={"factory": again}))
    assert np.abs(nominal.rows[1:3, 1]).max() < 1e-3, "no length of hundreds of metres is left"
    there = smr_positions(replace(nominal, tool=FORMATS["ur-calibration"].smr(export)), export.q)
    here = smr_positions(export.geometry.with_T_M_B(np.eye(4)), export.q)
    assert np.linalg.norm(there - here, axis=1).max() < BAR_M


# -- What other programs get is the same arm, and what they cannot get is said -----------------------------------------
