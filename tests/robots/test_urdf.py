"""URDFs: reading, writing, and refusing in one line what is damaged or no robot."""

import re
import shutil
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from khosla import close
from known_arms import Call
from marks import refused

from excitant.exceptions import BadRobot
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque, torque
from excitant.robots.appearance import Appearance
from excitant.robots.chains import RobotSpec
from excitant.robots.geometry import Scene, scene
from excitant.robots.urdf import robot_from_urdf

LOCKS = {
    "panda": {"panda_joint3": 0.4, "panda_joint7": -1.0},
    "ur10": {"shoulder_pan_joint": 0.3, "wrist_2_joint": -1.2},
    "planar_2r": {"joint1": 0.5},
    "gantry": {"swing": 0.7},
    "scara": {"elbow": 0.8, "roll": -0.5},
}


def same(left: Robot, right: Robot, motion: Motion, relative: float) -> bool:
    return close(rigid_body_torque(left, motion), rigid_body_torque(right, motion), relative)


@given(seed=st.integers(0, 2**32 - 1), lock=st.booleans())
def test_written_parameters_reload_to_their_torque(arm, random_states, random_bodies, seed, lock):
    """A locked arm needs the torque of the whole arm whose locked joints stand still."""
    held = LOCKS[arm.name] if lock else {}
    robot = robot_from_urdf(arm.urdf, RobotSpec("given", lock=held))
    motion, rows = random_states(robot, seed, 5), [arm.joint_index(j) for j in robot.joints]
    states = np.zeros((3, 5, arm.nv))
    states[0][:, [arm.joint_index(joint) for joint in held]] = [*held.values()]
    states[:, :, rows] = motion.q, motion.dq, motion.ddq
    tau = rigid_body_torque(arm, Motion(motion.t, *states))[:, rows]
    assert close(rigid_body_torque(robot, motion), tau, 1e-9)
    other = robot.with_parameters(random_bodies(seed, robot.nv))
    again = robot_from_urdf(other.urdf, "written")  # what is held is fixed
    assert again.joints == robot.joints
    assert same(other, again, motion, 1e-9)


def test_built_in_arm_keeps_limits_and_effects_of_the_joints_left(builtin: Robot) -> None:
    part = load_robot(builtin.name, lock=LOCKS[builtin.name])
    rows = [builtin.joint_index(joint) for joint in part.joints]
    assert np.array_equal(part.limits.acceleration, builtin.limits.acceleration[rows])
    some = load_robot(builtin.name, joints=part.joints)
    assert some.joints == part.joints
    assert np.array_equal(some.limits.torque, builtin.limits.torque[rows])

    def friction(robot: Robot) -> np.ndarray:
        zero = np.zeros((1, robot.nv))
        moving = Motion([0.0], zero, zero + 1, zero)
        return torque(robot, moving) - rigid_body_torque(robot, moving)

    assert np.allclose(friction(part), friction(builtin)[:, rows], rtol=1e-12, atol=1e-12)


def test_continuous_joints_have_no_limits_and_one_at_zero_is_a_limit(gantry, gantry_urdf):
    j = gantry.joint_index("swing")
    assert gantry.model.nq == gantry.nv == 3
    assert np.array_equal(gantry.limits.position[j], [-np.inf, np.inf])
    assert gantry.limits.velocity[j] == gantry.limits.torque[j] == np.inf
    assert gantry.revolute.tolist() == [False, True, True]
    robot = robot_from_urdf(gantry_urdf.replace('lower="-1"', 'lower="0"'), source="given")
    assert robot.limits.position[0].tolist() == [0.0, 1.5]


def test_joints_without_a_limit_are_named_together(gantry_urdf: str) -> None:
    for lack, told in (
        ("<limit.*?/>", "no <limit> of"),
        (' effort=".*?"', "no effort in the <limit> of"),
    ):
        given = re.sub(lack, "", gantry_urdf)
        refused(f"{told} slide, twist: give", robot_from_urdf, given, source="arm", error=BadRobot)


def test_robot_without_moving_joint(gantry_urdf: str) -> None:
    fixed = re.sub('type="(prismatic|continuous|revolute)"', 'type="fixed"', gantry_urdf)
    refused("no moving joints", robot_from_urdf, fixed, source="statue", error=BadRobot)
    none = RobotSpec("held", joints=())
    refused("no moving joints", robot_from_urdf, gantry_urdf, none, error=BadRobot)


def test_robot_yaml_says_what_the_urdf_cannot(gantry_urdf: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(gantry_urdf)
    path = tmp_path / "robot.yaml"
    path.write_text(
        "model: arm.urdf\njoints: [slide, twist]\nlock: {swing: 0.2}\ngravity: [0, 9.81, 0]\n"
        "limits: {acceleration: 4, torque: [300, 20]}\n"
        "effects: [{effect: coulomb_friction, joints: [twist], values: [0.5]}]\n"
    )
    robot, spec = load_robot(path), RobotSpec("gantry.urdf", lock={"swing": 0.2})
    assert (robot.joints, robot.effects[0].values) == (("slide", "twist"), (0.5,))
    assert [x.tolist() for x in (robot.gravity, robot.limits.torque)] == [[0, 9.81, 0], [300, 20]]
    expected = robot_from_urdf(gantry_urdf, spec, gravity=[0, 9.81, 0])
    motion = Motion(np.arange(4.0), *np.random.default_rng(0).standard_normal((3, 4, 2)))
    assert same(robot, expected, motion, 1e-12)


def test_effects_of_robot_yaml_join_those_of_its_model(gantry_urdf: str, tmp_path: Path) -> None:
    axis = '<axis xyz="0 0 -1"/>'
    text = gantry_urdf.replace(axis, f'{axis}<dynamics damping="0.7" friction="0.2"/>')
    (tmp_path / "arm.urdf").write_text(text)
    path = tmp_path / "robot.yaml"

    def effects(*entries: str) -> tuple[dict[str, object], tuple[str, ...]]:
        path.write_text(f"model: arm.urdf\neffects: [{', '.join(entries)}]\n")
        robot = load_robot(path)
        return {effect.name: effect.values for effect in robot.effects}, robot.notes

    friction = {"viscous_friction": (0.7,), "coulomb_friction": (0.2,)}
    rotor = "{effect: rotor_inertia, joints: [twist], values: [0.1]}"
    assert effects(rotor) == (friction | {"rotor_inertia": (0.1,)}, ())
    same = "{effect: viscous_friction, joints: [slide, twist], values: [3, 0.7]}"
    assert effects(same) == ({"coulomb_friction": (0.2,), "viscous_friction": (3, 0.7)}, ())
    found, (note,) = effects("{effect: coulomb_friction, joints: [twist], values: [0.4]}")
    assert found == friction | {"coulomb_friction": (0.4,)}
    assert note == "Coulomb friction: as in robot.yaml, not as in its model"


def test_links_may_be_called_as_joints(gantry_urdf: str, random_states: Call) -> None:
    """Names of links change nothing, even where Pinocchio cannot hold two of one name."""
    text = gantry_urdf
    for link, joint in (("cart", "slide"), ("arm", "swing"), ("hand", "twist")):
        text = re.sub(rf'(link(?: name)?=?"?){link}"', rf'\g<1>{joint}"', text)
    assert '<link name="slide">' in text
    spec = RobotSpec("gantry.urdf", lock={"swing": 0.3})
    part, robot = (robot_from_urdf(given, spec) for given in (gantry_urdf, text))
    assert robot.joints == robot.links == ("slide", "twist")
    motion = random_states(part, 0, 8)
    assert same(robot, part, motion, 1e-12)
    assert same(robot_from_urdf(robot.urdf, "gantry.urdf"), part, motion, 1e-9)
    ours, theirs = (Appearance(each).entries() | {"notes": []} for each in (robot, part))
    assert ours == theirs
    named = ((gantry_urdf, "hand"), (text, "twist"))
    one, other = (robot_from_urdf(urdf, RobotSpec("arm", tip=tip)).tip for urdf, tip in named)
    assert one == other


def test_a_robot_without_a_name_is_called_as_its_file(tmp_path: Path, gantry_urdf: str) -> None:
    path = tmp_path / "unnamed.urdf"
    path.write_text(gantry_urdf.replace('<robot name="gantry">', "<robot>"))
    assert load_robot(path).name == "unnamed"


def test_meshes_beside_a_file_are_found_anywhere(tmp_path, gantry_urdf, random_states, monkeypatch):
    path = Path(shutil.copytree(Path(__file__).parent / "data", tmp_path / "data")) / "gantry.urdf"
    packaged, package = (
        path.parent / "arm_description",
        "package://arm_description/meshes/wedge.stl",
    )
    monkeypatch.chdir(tmp_path)

    def found(mesh: str) -> Scene | None:
        shape = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
        path.write_text(gantry_urdf.replace("</link>", shape))
        return scene(load_robot(path))

    beside = found("wedge.stl")
    assert beside is not None
    assert np.isfinite(beside.distances(random_states(beside.robot, 0, 8).q)).all()
    (packaged / "meshes").mkdir(parents=True)
    shutil.copy(path.parent / "wedge.stl", packaged / "meshes")
    assert found(package) is not None
    assert found("none.stl") is None
    elsewhere = Path(shutil.move(packaged, tmp_path / "ros" / "share" / "arm_description"))
    assert found(package) is None
    prefix = elsewhere.parents[1]
    for variable, folder in (("AMENT_PREFIX_PATH", prefix), ("ROS_PACKAGE_PATH", elsewhere)):
        monkeypatch.setenv(variable, str(folder))
        assert found(package) is not None
        monkeypatch.delenv(variable)
