"""What the doctor says about obstacles."""

from __future__ import annotations

from cellapp.cell.driving.examination import examine
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import BoxObstacle, CapsuleObstacle, Placement, SphereObstacle
from drivers.findings import Finding
from tests.cell.safety.test_gate import with_obstacles
from tests.twin import PROFILES, small_twin


def found(profile: Profile) -> dict[str, Finding]:
    return {one.subject: one for one in examine(profile)}


def test_distances_at_home_and_what_stands_on_what() -> None:
    profile = with_obstacles(
        table=BoxObstacle(shape="box", size=(1.0, 3.0, 0.1), pose=Placement(position=(0.0, 0.0, -0.15))),
        lamp=SphereObstacle(shape="sphere", radius=0.1, pose=Placement(position=(0.0, 0.0, 1.0))),
        tool=BoxObstacle(shape="box", fixed_to="flange", arm="left", size=(0.1, 0.1, 0.1)),
        hose=CapsuleObstacle(shape="capsule", fixed_to="flange", arm="right", radius=0.02, length=0.1),
    )
    findings = found(profile)
    assert findings["obstacle table"].status == findings["obstacle lamp"].status == "ok"
    assert "left, right on or beside it: base and first link are not checked" in findings["obstacle table"].text
    assert findings["obstacle lamp"].text.startswith("distance at home: arm left ")
    assert "beside it" not in findings["obstacle lamp"].text
    assert "on the flange of arm left; checks use 6 capsules around it, which reach up to" in (
        findings["obstacle tool"].text
    )
    assert findings["obstacle hose"].text == "on the flange of arm right"
    assert findings["home"].status == "ok"


def test_an_obstacle_too_near_to_home_is_told() -> None:
    profile = with_obstacles(
        small_twin(plan={"clearance": 0.08}),
        post=SphereObstacle(shape="sphere", radius=0.1, pose=Placement(position=(0.0, -0.62, 0.5))),
    )
    reason = refuse_stop(cell_bodies(profile), home_positions(profile))
    assert reason.startswith("arm right: comes within")
    findings = found(profile)
    assert findings["obstacle post"].status == "failed"
    assert "arm right must keep 80 mm; change obstacles.post, arms.*.home" in findings["obstacle post"].text
    assert findings["home"].status == "failed"
    assert findings["home"].text.startswith(reason)


def test_an_obstacle_around_an_arm_ends_the_check_of_the_placement() -> None:
    profile = with_obstacles(
        post=SphereObstacle(shape="sphere", radius=0.1, pose=Placement(position=(0.0, -0.85, 0.5)))
    )
    findings = found(profile)
    assert findings["obstacles"].status == "failed"
    assert "obstacles.post.pose: arm right at home reaches" in findings["obstacles"].text
    assert "home" not in findings


def test_the_real_cell_has_a_table_and_a_pillar_and_is_safe_at_home() -> None:
    profile = load_profile(PROFILES / "ur10-ur5.yaml")
    assert {"table", "pillar"} <= set(profile.obstacles)
    assert refuse_stop(cell_bodies(profile), home_positions(profile)) == ""
