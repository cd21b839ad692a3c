from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import yaml

from excitant.design import FourierTrajectory, random_trajectory
from excitant.design.formats import (
    NamedMotion,
    joint_trajectory_yaml,
    mcap_bag,
    npz,
    read_joint_trajectory_yaml,
    read_mcap_bag,
    read_npz,
    read_urscript,
    urscript,
    write_formats,
)
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Motion, Robot

NANOSECOND = 0.5e-9 + 1e-15  # of rounding, and of adding seconds to nanoseconds


@pytest.fixture(scope="module")
def trajectory(ur10: Robot) -> FourierTrajectory:
    return random_trajectory(ur10, np.random.default_rng(0), 3.0, 3)


@pytest.fixture(scope="module")
def motion(trajectory: FourierTrajectory) -> Motion:
    """Awkward numbers: times that are no multiples of 1 ns, tiny and huge values."""
    motion = trajectory.motion(130.0)
    q = np.array(motion.q)
    q[5] = [1e-17, -1e-5, 1e22, -0.0, 1 / 3, 5e-324]
    return replace(motion, q=q, t=motion.t + 7.0)


def assert_equal(read: NamedMotion, motion: Motion, robot: Robot) -> None:
    assert read.joints == robot.joints
    assert np.abs(read.motion.t - (motion.t - motion.t[0])).max() <= NANOSECOND
    for name in ("q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(read.motion, name), getattr(motion, name))


def test_yaml_is_read_back_equal(ur10: Robot, motion: Motion) -> None:
    text = joint_trajectory_yaml(motion, ur10)
    assert_equal(read_joint_trajectory_yaml(text), motion, ur10)


def test_yaml_is_the_message_that_ros_expects(ur10: Robot, motion: Motion) -> None:
    content = yaml.safe_load(joint_trajectory_yaml(motion[:9], ur10))
    assert list(content) == ["header", "joint_names", "points"]
    assert content["joint_names"] == list(ur10.joints)
    for point in content["points"]:
        fields = ["positions", "velocities", "accelerations", "effort", "time_from_start"]
        assert list(point) == fields
        assert all(isinstance(x, float) for field in fields[:3] for x in point[field])
        assert {type(v) for v in point["time_from_start"].values()} == {int}
        assert 0 <= point["time_from_start"]["nanosec"] < 10**9


def test_mcap_is_read_back_equal(ur10: Robot, motion: Motion) -> None:
    assert_equal(read_mcap_bag(mcap_bag(motion, ur10)), motion, ur10)


def test_npz_is_read_back_exactly(ur10: Robot, motion: Motion) -> None:
    read = read_npz(npz(motion, ur10))
    assert read.joints == ur10.joints
    for name in ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(read.motion, name), getattr(motion, name))


def test_urscript_is_read_back_equal(ur10: Robot, trajectory: FourierTrajectory) -> None:
    motion = trajectory.motion(125.0)
    program = read_urscript(urscript(motion, ur10))
    np.testing.assert_allclose(program.q, motion.q, rtol=0, atol=5.1e-13)
    np.testing.assert_allclose(program.t, motion.t, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(program.first, program.q[0])


def test_urscript_goes_to_the_first_pose_before_it_servoes_and_stops_at_the_end(
    ur10: Robot, trajectory: FourierTrajectory
) -> None:
    lines = [line.strip() for line in urscript(trajectory.motion(125.0), ur10).splitlines()]
    verbs = [line.split("(")[0] for line in lines if not line.startswith("#")]
    n = len(trajectory.motion(125.0))
    assert verbs == ["def excitant_motion", "movej", *["servoj"] * n, "stopj", "end", verbs[-1]]
    servo = [line for line in lines if line.startswith("servoj")]
    assert all(line.endswith("t=0.008, lookahead_time=0.1, gain=300)") for line in servo)


def test_urscript_refuses_other_arms_and_uneven_samples(
    planar: Robot, ur10: Robot, motion: Motion
) -> None:
    with pytest.raises(BadInput, match="six turning joints, planar_2r has 2 joints"):
        urscript(Motion(np.arange(2.0), *np.zeros((3, 2, 2))), planar)
    with pytest.raises(BadInput, match="equidistant"):
        urscript(motion[np.array([0, 1, 3, 4])], ur10)


def test_write_formats_names_the_files(ur10: Robot, trajectory: FourierTrajectory) -> None:
    names = ("ros2", "mcap", "urscript", "npz")
    files = write_formats(trajectory, ur10, names, rate_hz=50.0, stem="approach")
    assert list(files) == [f"approach.{s}" for s in ("yaml", "mcap", "script", "npz")]
    motion = trajectory.motion(50.0)
    text, bag, archive = (files[f"approach.{s}"] for s in ("yaml", "mcap", "npz"))
    assert isinstance(text, str)
    assert isinstance(bag, bytes)
    assert isinstance(archive, bytes)
    assert_equal(read_joint_trajectory_yaml(text), motion, ur10)
    assert_equal(read_mcap_bag(bag), motion, ur10)
    assert_equal(read_npz(archive), motion, ur10)


def test_write_formats_refuses(planar: Robot, ur10: Robot, motion: Motion) -> None:
    with pytest.raises(UnknownName, match="unknown format 'mcp': did you mean 'mcap'"):
        write_formats(motion, ur10, ["npz", "mcp"])
    with pytest.raises(BadInput, match="motion has 6 joints, robot planar_2r has 2"):
        write_formats(motion, planar, ["npz"])
    with pytest.raises(BadInput, match="not finite"):
        write_formats(replace(motion, q=motion.q * np.nan), ur10, ["npz"])
    with pytest.raises(BadInput, match="at least two samples"):
        write_formats(motion[:1], ur10, ["npz"])
    with pytest.raises(BadInput, match="times that increase"):
        write_formats(motion[np.array([0, 0])], ur10, ["npz"])
    close = replace(motion[:2], t=np.array([0.0, 1e-10]))
    for name in ("ros2", "mcap"):
        with pytest.raises(BadInput, match="less than 1 ns apart"):
            write_formats(close, ur10, [name])


def test_readers_refuse_what_they_cannot_read(ur10: Robot, motion: Motion) -> None:
    for text in ("[", "1", "points: []", "{joint_names: [a], points: [{positions: [1.0]}]}"):
        with pytest.raises(BadInput, match="not a trajectory_msgs"):
            read_joint_trajectory_yaml(text)
    short = joint_trajectory_yaml(motion, ur10).replace("shoulder_pan_joint, ", "")
    with pytest.raises(BadInput, match="5 names of joints for 6 positions"):
        read_joint_trajectory_yaml(short)
    for content in (b"", b"no bag", mcap_bag(motion, ur10)[:200]):
        with pytest.raises(BadInput, match="not a readable MCAP bag"):
            read_mcap_bag(content)
    buffer = io.BytesIO()
    np.savez(buffer, t=motion.t)
    for content in (b"", b"text", buffer.getvalue()):
        with pytest.raises(BadInput, match="not a NumPy archive"):
            read_npz(content)
    for text in ("", "movej([0,0], a=1)"):
        with pytest.raises(BadInput, match="not a program"):
            read_urscript(text)
