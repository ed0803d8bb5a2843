"""Hidden effects under load against analytic springs, beams and columns."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import root

from drivers.plant import gravity_torques
from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES
from drivers.plant.mechanism import STANDARD_GRAVITY, Posture, nominal

Q = np.random.default_rng(7).uniform(-2.5, 2.5, (8, 6))
DOWN = np.array([0.0, 0.0, -STANDARD_GRAVITY])


def _positions(make_arm, make_plant, effects, q=Q, **situation):
    return make_plant(make_arm(effects=effects)).smr_positions("left", q, **situation)


def _effect(name, values, joints=6):
    return FACTORIES[name](Parameters("left", name, values, joints))


# -- springs in the joints ---------------------------------------------------------------------------------------------


def test_under_the_load_each_drive_spring_balances_the_load_alone(make_arm, make_plant):
    stiffness = np.array([3e4, 4e4, 2e4, 8e3, 8e3, 8e3])
    center = np.array([0.05, -0.02, 0.1])
    found = _positions(
        make_arm,
        make_plant,
        {"payload_compliance": {"stiffness": stiffness.tolist()}},
        payload=np.full(8, 6.0),
        payload_center=center,
    )
    loaded, bare = make_arm(payload_mass=6.0, payload_center=center), make_arm()
    joints = Q.copy()
    for _ in range(30):
        joints = Q + (gravity_torques(loaded, joints) - gravity_torques(bare, joints)) / stiffness
    assert np.abs(joints - Q).max() > 1e-3
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-11


def test_without_a_load_the_controller_has_made_up_for_everything(make_arm, make_plant):
    effects = {"payload_compliance": {"stiffness": [1e4] * 6}}
    assert np.array_equal(_positions(make_arm, make_plant, effects), make_plant().smr_positions("left", Q))


def test_a_drive_is_soft_up_to_the_knee_and_stiffer_beyond(make_arm, make_plant):
    stiff, soft, knee = np.full(6, 5e4), np.full(6, 3e4), np.array([10.0, 30.0, 8.0, 1.0, 0.2, 0.1])
    values = {"stiffness": stiff.tolist(), "soft_stiffness": soft.tolist(), "knee": knee.tolist()}
    found = _positions(make_arm, make_plant, {"joint_compliance": values})
    joints = Q.copy()
    for _ in range(40):
        torque = gravity_torques(make_arm(), joints)
        beyond = np.maximum(np.abs(torque) - knee, 0.0)
        joints = Q + np.sign(torque) * ((np.abs(torque) - beyond) / soft + beyond / stiff)
    assert (np.abs(torque) > knee).any()
    assert (np.abs(torque) < knee).any()
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-11


@pytest.mark.parametrize("knee", [0.0, 1e4])
def test_a_knee_out_of_reach_leaves_one_stiffness(make_arm, make_plant, knee):
    values = {"stiffness": [5e4] * 6, "soft_stiffness": [3e4] * 6, "knee": [knee] * 6}
    one = {"stiffness": [3e4 if knee else 5e4] * 6}
    found = _positions(make_arm, make_plant, {"joint_compliance": values})
    assert np.abs(found - _positions(make_arm, make_plant, {"joint_compliance": one})).max() < 1e-13


def test_friction_winds_the_drive_up_against_the_last_motion(make_arm, make_plant):
    values = {"friction": [5.0] * 6, "load_friction": [0.0] * 6, "stiffness": [5e4] * 6}
    side = np.random.default_rng(0).choice([-1.0, 1.0], (8, 6))
    found = _positions(make_arm, make_plant, {"friction_windup": values}, approach=side)
    assert np.abs(found - make_plant().smr_positions("left", Q - side * 1e-4)).max() < 1e-12
    unmoved = _positions(make_arm, make_plant, {"friction_windup": values})
    assert np.array_equal(unmoved, make_plant().smr_positions("left", Q))


def test_friction_grows_with_the_load_on_the_joint(make_arm, make_plant):
    values = {"friction": [0.0] * 6, "load_friction": [0.1] * 6, "stiffness": [5e4] * 6}
    side = np.ones((8, 6))
    found = _positions(make_arm, make_plant, {"friction_windup": values}, approach=side, payload=np.full(8, 7.0))
    joints = Q.copy()
    for _ in range(20):
        joints = Q - 0.1 * np.abs(gravity_torques(make_arm(payload_mass=7.0), joints)) / 5e4
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-12


def test_a_step_shorter_than_the_windup_winds_no_further(make_arm, make_plant):
    values = {"friction": [5.0] * 6, "load_friction": [0.0] * 6, "stiffness": [5e4] * 6}
    found = _positions(make_arm, make_plant, {"friction_windup": values}, last_step=np.full((8, 6), -3e-5))
    assert np.abs(found - make_plant().smr_positions("left", Q + 3e-5)).max() < 1e-12


# -- beams -------------------------------------------------------------------------------------------------------------

LENGTH, EI, GJ = 0.612, 8e4, 6e4  # of the UR10's upper arm
LEVEL = np.zeros((1, 6))  # both beams lie level, along -x of B


def _tip(arm, links=(2,), bending=EI, torsion=GJ, q=LEVEL):
    """Twist of the first of ``links`` as it bends at ``q``, turned into B: shift and rotation vector."""
    effect = _effect(
        "link_bending",
        {"links": list(links), "bending": [bending] * len(links), "torsion": [torsion] * len(links)},
    )
    posture = Posture(nominal(arm), q, DOWN)
    twist = effect.bend(SimpleNamespace(), posture).links[0, links[0] - 1]
    turn = (posture.placements[links[0] - 1] @ posture.mechanism.frames[links[0]])[0, :3, :3]
    return turn @ twist[:3], turn @ twist[3:]


def _only(make_arm, **bodies):
    """An arm whose bodies weigh nothing but those named: ``_2=(mass, centre)``."""
    masses, centers = np.zeros(6), np.zeros((6, 3))
    for name, (mass, center) in bodies.items():
        number = int(name[1:]) - 1
        masses[number], centers[number] = mass, center
    return make_arm(masses=masses, centers_of_mass=centers)


def test_a_weight_at_the_tip_bends_the_beam_as_a_cantilever(make_arm):
    arm = _only(make_arm, _3=(5.0, [0.5723, 0.0, 0.0]))  # a body that hangs at the tip of link 2
    shift, turn = _tip(arm)
    force = 5.0 * STANDARD_GRAVITY
    # a beam of 12 segments is a little softer than a smooth one: 1 / (8 * 144) of it
    assert shift[2] == pytest.approx(-force * LENGTH**3 / (3 * EI), rel=3e-3)
    assert np.linalg.norm(turn) == pytest.approx(force * LENGTH**2 / (2 * EI), rel=3e-3)
    assert turn[1] < 0.0  # the tip, at -x, sinks: a turn about -y
    assert np.abs(turn[[0, 2]]).max() < 1e-12


def test_a_weight_beyond_the_tip_bends_it_by_its_moment_too(make_arm):
    ahead = 0.4
    arm = _only(make_arm, _3=(5.0, [0.5723 - ahead, 0.0, 0.0]))
    shift, turn = _tip(arm)
    force = 5.0 * STANDARD_GRAVITY
    assert shift[2] == pytest.approx(-force * (LENGTH**3 / (3 * EI) + ahead * LENGTH**2 / (2 * EI)), rel=3e-3)
    assert -turn[1] == pytest.approx(force * (LENGTH**2 / (2 * EI) + ahead * LENGTH / EI), rel=3e-3)


def test_a_weight_beside_the_beam_twists_it(make_arm):
    aside = 0.15
    arm = _only(make_arm, _3=(5.0, [0.5723, 0.0, aside]))  # z of the frame lies level, across the beam
    _, turn = _tip(arm)
    assert np.abs(turn[0]) == pytest.approx(5.0 * STANDARD_GRAVITY * aside * LENGTH / GJ, rel=1e-9)


def test_own_weight_bends_the_beam_like_a_distributed_load(make_arm):
    arm = _only(make_arm, _2=(12.0, [LENGTH / 2, 0.0, 0.0]))
    shift, turn = _tip(arm)
    load = 12.0 * STANDARD_GRAVITY / LENGTH
    assert shift[2] == pytest.approx(-load * LENGTH**4 / (8 * EI), rel=1e-2)
    assert -turn[1] == pytest.approx(load * LENGTH**3 / (6 * EI), rel=1e-2)


def test_more_weight_towards_the_root_bends_the_beam_less(make_arm):
    even = _only(make_arm, _2=(12.0, [LENGTH / 2, 0.0, 0.0]))
    rooted = _only(make_arm, _2=(12.0, [0.6 * LENGTH, 0.0, 0.0]))  # the root is at +x of the frame
    assert 0.0 > _tip(rooted)[0][2] > _tip(even)[0][2]


def test_an_upright_beam_under_a_centred_weight_stays_straight(make_arm):
    arm = _only(make_arm, _3=(5.0, [0.5723, 0.0, 0.0]))
    shift, turn = _tip(arm, q=np.array([[0.3, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]]))
    assert np.abs(shift).max() < 1e-12
    assert np.abs(turn).max() < 1e-12


def test_stiff_beams_do_not_bend_and_the_joint_end_stays(make_arm, make_plant):
    stiff = {"links": [2, 3], "bending": [np.inf] * 2, "torsion": [np.inf] * 2}
    ideal = make_plant().smr_positions("left", Q)
    assert np.abs(_positions(make_arm, make_plant, {"link_bending": stiff}) - ideal).max() < 1e-14
    soft = {"links": [2, 3], "bending": [1e5] * 2, "torsion": [7e4] * 2}
    bent = _positions(make_arm, make_plant, {"link_bending": soft}) - ideal
    assert 1e-4 < np.linalg.norm(bent, axis=1).max() < 2e-3
    half = {"links": [2, 3], "bending": [2e5] * 2, "torsion": [14e4] * 2}
    straighter = _positions(make_arm, make_plant, {"link_bending": half}) - ideal
    assert bent == pytest.approx(2.0 * straighter, abs=2e-6)


def test_the_last_link_bends_under_the_load_alone(make_arm):
    massless = {"masses": np.zeros(6), "centers_of_mass": np.zeros((6, 3))}
    shift, _ = _tip(make_arm(payload_mass=5.0, **massless), links=(6,))  # it lies level, along y
    assert shift[2] == pytest.approx(-5.0 * STANDARD_GRAVITY * 0.0922**3 / (3 * EI), rel=3e-3)
    assert np.abs(_tip(make_arm(**massless), links=(6,))[0]).max() == 0.0


def test_a_beam_without_length_does_not_bend(make_arm, make_plant):
    rows = make_arm().rows.copy()
    rows[4, 1] = 0.0  # joints 5 and 6 meet in a point
    plain, bent = (
        make_plant(make_arm(rows=rows, effects=effects)).smr_positions("left", Q)
        for effects in ({}, {"link_bending": {"links": [5], "bending": [1.0], "torsion": [1.0]}})
    )
    assert np.array_equal(plain, bent)


# -- what the arm stands on --------------------------------------------------------------------------------------------


def test_the_column_bends_as_a_cantilever_under_the_moment_of_the_arm(make_arm):
    arm = _only(make_arm, _3=(10.0, [0.0, 0.0, 0.0]))
    posture = Posture(nominal(arm), LEVEL, DOWN)
    height, bending = 0.8, 2e6
    values = {"height": height, "bending": [bending, bending], "torsion": 3e6}
    base = _effect("pedestal_compliance", values).bend(SimpleNamespace(), posture).base[0]
    moment = 10.0 * STANDARD_GRAVITY * (0.612 + 0.5723)
    assert base[4] == pytest.approx(-moment / bending)  # the weight hangs at -x
    assert base[0] == pytest.approx(-moment / bending * height / 2)
    assert np.abs(base[[2, 3, 5]]).max() < 1e-15


def test_a_column_leans_with_its_weaker_side_and_an_upright_one_does_not_twist(make_arm, make_plant):
    values = {"height": 0.5, "bending": [np.inf, 1e6], "torsion": 1e3}
    posture = Posture(nominal(make_arm()), Q, DOWN)
    base = _effect("pedestal_compliance", values).bend(SimpleNamespace(), posture).base
    assert np.abs(base[:, [1, 3, 5]]).max() == 0.0
    assert base[:, 4] == pytest.approx(posture.base_moment[:, 1] / 1e6)


def test_the_column_carries_the_moment_of_the_deflected_arm(make_arm, make_plant):
    """With a column a thousand times too soft the moment of the deflected posture differs from the first one."""
    values = {"height": 1.0, "bending": [2e3, 2e3], "torsion": 2e3}
    plant = make_plant(make_arm(effects={"pedestal_compliance": values}))
    arm = plant._arm("left")
    plant.targets()
    base = arm.load_deflection.base
    posture = Posture(arm.mechanism, plant.q("left")[None], arm.gravity, arm.load_deflection)
    again = _effect("pedestal_compliance", values).bend(SimpleNamespace(), posture).base
    first = (
        _effect("pedestal_compliance", values)
        .bend(SimpleNamespace(), Posture(arm.mechanism, plant.q("left")[None], arm.gravity))
        .base
    )
    assert np.abs(again - base).max() < 1e-11
    assert np.abs(first - base).max() > 1e-4


COUPLING = {"bending": 2e6, "torsion": 2e6, "depth": 0.0}


def test_the_moment_of_the_other_arm_turns_this_base(make_arm, make_plant):
    right = make_arm("ur5", "right", 1.2)
    plant = make_plant(make_arm(effects={"pedestal_coupling": COUPLING}), right)
    other = np.random.default_rng(2).uniform(-2, 2, (8, 6))
    moment = Posture(nominal(right), other, DOWN).base_moment
    found = plant.smr_positions("left", Q, others={"right": other})
    T_M_B = plant.true_T_M_B("left")
    p_B = (plant_free(make_plant, make_arm, right).smr_positions("left", Q) - T_M_B[:3, 3]) @ T_M_B[:3, :3]
    turned = p_B + np.cross(moment / 2e6, p_B)
    assert np.abs(found - (turned @ T_M_B[:3, :3].T + T_M_B[:3, 3])).max() < 5e-9
    # it depends on nothing else of the other arm, and a weightless one turns nothing
    light = make_arm("ur5", "right", 1.2, masses=np.zeros(6))
    still = make_plant(make_arm(effects={"pedestal_coupling": COUPLING}), light)
    assert np.array_equal(
        still.smr_positions("left", Q, others={"right": other}),
        plant_free(make_plant, make_arm, light).smr_positions("left", Q),
    )


def plant_free(make_plant, make_arm, right):
    """The same two arms without the effect."""
    return make_plant(make_arm(), right)


def test_the_orientation_of_the_other_base_does_not_matter(make_arm, make_plant):
    values = COUPLING | {"bending": 1e6, "depth": 0.5}
    turned = make_arm("ur5", "right", 1.2).T_C_B @ np.diag([-1.0, -1.0, 1.0, 1.0])
    other = np.random.default_rng(2).uniform(-2, 2, (8, 6))
    about = other.copy()
    about[:, 0] += np.pi
    left = make_arm(effects={"pedestal_coupling": values})
    one = make_plant(left, make_arm("ur5", "right", 1.2))
    two = make_plant(left, make_arm("ur5", "right", 1.2, T_C_B=turned))
    found = one.smr_positions("left", Q, others={"right": other})
    assert np.abs(found - two.smr_positions("left", Q, others={"right": about})).max() < 1e-13


def test_the_beam_twists_and_bends_by_its_own_stiffness(make_arm, make_plant):
    """An arm stretched along the beam bends it without torsion; stretched across, it only twists it."""
    right = make_arm("ur5", "right", 1.2, centers_of_mass=np.zeros((6, 3)))
    free = plant_free(make_plant, make_arm, right)
    only_twist = make_plant(make_arm(effects={"pedestal_coupling": COUPLING | {"bending": np.inf}}), right)
    for yaw, larger in ((0.0, False), (np.pi / 2, True)):
        other = {"right": np.tile([yaw, 0.0, 0.0, 0.0, 0.0, 0.0], (8, 1))}
        moved = only_twist.smr_positions("left", Q, others=other) - free.smr_positions("left", Q, others=other)
        assert (np.abs(moved).max() > 3e-6) == larger


def test_pedestal_coupling_does_nothing_to_a_single_arm(make_arm, make_plant):
    found = _positions(make_arm, make_plant, {"pedestal_coupling": COUPLING})
    assert np.array_equal(found, make_plant().smr_positions("left", Q))


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"payload_compliance": {"stiffness": [1e4] * 5}}, "stiffness must be a list of 6 numbers"),
        ({"payload_compliance": {"stiffness": 1e4}}, "stiffness must be a list of 6 numbers, not 10000"),
        ({"payload_compliance": {"stiffness": [-np.inf] * 6}}, "stiffness must hold numbers in SI units, not -inf"),
        (
            {"joint_compliance": {"stiffness": [1e4] * 6, "knee": [1] * 6}},
            "soft_stiffness, knee belong together, but only knee is given",
        ),
        (
            {"joint_compliance": {"stiffness": [1e4] * 6, "soft_stiffness": [2e4] * 6, "knee": [1] * 6}},
            "soft_stiffness must not be greater than stiffness",
        ),
        ({"joint_compliance": {"stiff": [1e4] * 6}}, r"are stiffness, soft_stiffness \(optional\), knee \(optional\)"),
        (
            {"friction_windup": {"friction": [-1] * 6, "load_friction": [0] * 6, "stiffness": [1e4] * 6}},
            "friction must be at least 0, not -1",
        ),
        (
            {"friction_windup": {"friction": [np.inf] * 6, "load_friction": [0] * 6, "stiffness": [1e4] * 6}},
            "friction must hold numbers in SI units, not inf",
        ),
        ({"link_bending": {"links": [7], "bending": [1e5], "torsion": [1e5]}}, "joint numbers from 1 to 6"),
        ({"link_bending": {"links": [2], "bending": [0], "torsion": [1e5]}}, "bending must be greater than 0, not 0"),
        (
            {"pedestal_compliance": {"height": -1, "bending": [1e6] * 2, "torsion": 1e6}},
            "height must be at least 0, not -1",
        ),
        (
            {"pedestal_compliance": {"height": 1, "bending": 1e6, "torsion": 1e6}},
            "bending must be a list of 2 numbers",
        ),
        ({"pedestal_coupling": COUPLING | {"torsion": 0.0}}, "torsion must be greater than 0"),
        ({"pedestal_coupling": COUPLING | {"depth": "1 m"}}, "depth must be a number in SI units, not '1 m'"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(make_arm, make_plant, effects, message):
    with pytest.raises(ValueError, match=f"arm left, effect {next(iter(effects))}: .*{message}"):
        make_plant(make_arm(effects=effects))


def test_a_stiffness_without_equilibrium_is_refused(make_arm, make_plant):
    with pytest.raises(ValueError, match="arm left: the hidden effects reach no equilibrium"):
        _positions(make_arm, make_plant, {"payload_compliance": {"stiffness": [1.0] * 6}}, payload=np.full(8, 10.0))


# -- Gravity torques and elastic joints --------------------------------------------------------------------------------


def _largest(arm, joint):
    """The largest torque on a joint over all postures: coordinate search, exact enough as the torque is sinusoidal."""
    turn = np.linspace(-np.pi, np.pi, 361)
    best = 0.0
    for start in np.random.default_rng(0).uniform(-np.pi, np.pi, (4, 6)):
        q = start.copy()
        for _ in range(6):
            for k in range(1, 6):
                trial = np.tile(q, (len(turn), 1))
                trial[:, k] = turn
                torque = np.abs(gravity_torques(arm, trial)[:, joint])
                q[k] = turn[np.argmax(torque)]
        best = max(best, float(torque.max()))
    return best


@pytest.mark.parametrize(
    ("kind", "payload", "published", "within"),
    [
        ("ur10", 0.0, (122, 41, 3), 0.5),
        ("ur5", 0.0, (55, 17, 1.5), 0.5),
        # the published loads hang in front of the flange; one distance for both arms fits all six figures
        ("ur10", 10.0, (257, 117, 23), 1.0),
        ("ur5", 5.0, (104, 45, 10), 1.0),
    ],
)
def test_the_largest_gravity_torques_are_the_published_ones(make_arm, kind, payload, published, within):
    arm = make_arm(kind, payload_mass=payload, payload_center=np.array([0.0, 0.0, 0.08]))
    found = [_largest(arm, joint) for joint in (1, 2, 3)]
    assert found == pytest.approx(published, abs=within)


@pytest.mark.parametrize("payload", [0.0, 4.0])
def test_the_torque_is_the_slope_of_the_potential_energy(make_arm, dh_frames, payload):
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # on a wall: every joint feels gravity
    arm = make_arm(T_C_B=pose, payload_mass=payload, payload_center=np.array([0.02, -0.03, 0.1]))

    def energy(q):
        frames = dh_frames(arm.rows, q)
        places = [frame @ np.append(c, 1.0) for frame, c in zip(frames[1:], arm.centers_of_mass)]
        weights = np.append(arm.masses, payload)
        places.append(frames[-1] @ np.append(arm.payload_center, 1.0))
        return STANDARD_GRAVITY * sum(m * (pose @ p)[2] for m, p in zip(weights, places))

    step = 1e-5
    for q in np.random.default_rng(2).uniform(-np.pi, np.pi, (5, 6)):
        slope = [(energy(q + step * unit) - energy(q - step * unit)) / (2 * step) for unit in np.eye(6)]
        torque = gravity_torques(arm, q)[0]
        assert torque == pytest.approx(-np.array(slope), abs=1e-6)
        assert np.abs(torque).max() > 1.0


def test_springs_balance_gravity_at_the_deflected_posture(make_arm, make_config, make_plant, dh_smr):
    stiffness = np.array([2e4, 1.5e4, 1e4, 3e3, 3e3, 1e3])  # soft, so that the undeflected posture is not good enough
    arm = make_arm(
        payload_mass=8.0,
        payload_center=np.array([0.05, 0.0, 0.1]),
        effects={"joint_compliance": {"stiffness": stiffness.tolist()}},
    )
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (20, 6))
    balanced = []
    for row in q:
        solved = root(lambda x: stiffness * (x - row) - gravity_torques(arm, x)[0], row, tol=1e-14)  # noqa: B023
        balanced.append(solved.x)
    config, plant = make_config(arm), make_plant(arm)
    found = plant.smr_positions("left", q)
    assert np.abs(found - dh_smr(config, np.array(balanced))).max() < 2e-12
    first_order = q + gravity_torques(arm, q) / stiffness
    assert np.abs(found - dh_smr(config, first_order)).max() > 1e-5
    assert np.abs(found - dh_smr(config, q)).max() > 1e-3


def test_gravity_pulls_the_hand_down(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [5e4] * 6}})
    stretched = np.zeros((1, 6))
    sag = make_plant(arm).smr_positions("left", stretched) - make_plant(make_arm()).smr_positions("left", stretched)
    assert -5e-3 < sag[0, 2] < -1e-3


def test_an_infinite_stiffness_is_stiff(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [float("inf")] * 6}})
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    assert np.array_equal(make_plant(arm).smr_positions("left", q), make_plant().smr_positions("left", q))


def test_a_load_hung_on_later_acts_like_one_configured(make_arm, make_plant):
    effects = {"joint_compliance": {"stiffness": [5e4] * 6}}
    center = np.array([0.0, 0.02, 0.08])
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    plant = make_plant(make_arm(effects=effects))
    bare = plant.smr_positions("left", q)
    plant.set_payload("left", 6.0, center)
    configured = make_plant(make_arm(effects=effects, payload_mass=6.0, payload_center=center))
    assert np.array_equal(plant.smr_positions("left", q), configured.smr_positions("left", q))
    assert np.abs(plant.smr_positions("left", q) - bare).max() > 1e-4
    assert plant.payload("left")[0] == 6.0


def test_springs_too_soft_to_hold_the_arm_are_refused(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [5.0] * 6}})
    with pytest.raises(ValueError, match="arm left: the hidden effects reach no equilibrium"):
        make_plant(arm).smr_positions("left", np.full((1, 6), 0.3))
