"""Damaged robot descriptions: one line that names the file, or an arm whose torque is finite."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from excitant.exceptions import ExcitantError
from excitant.robots import Motion, load_robot, torque

URDF = """<?xml version="1.0"?>
<robot name="three">
  <link name="world"/>
  <link name="base"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="4"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.05"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.1 0 0.2" rpy="0 0.3 0"/><mass value="3"/>
    <inertia ixx="0.1" ixy="0.01" ixz="0" iyy="0.12" iyz="0" izz="0.03"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.15" rpy="0 0 0"/><mass value="2"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.01"/></inertial>
    <collision><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision></link>
  <link name="tool"/>
  <joint name="fixed" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="pan" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.2" rpy="0 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="100"/>
    <dynamics damping="1" friction="2"/></joint>
  <joint name="lift" type="prismatic"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4" rpy="1.57 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-0.5" upper="0.5" velocity="1" effort="80"/></joint>
  <joint name="grip" type="fixed"><parent link="fore"/><child link="tool"/>
    <origin xyz="0 0 0.3"/></joint>
</robot>
"""
VALUES = ("nan", "inf", "-inf", "-1", "0", "1e308", "1e-308", "", "abc", "1,5", "0x10", "٣")


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """The description with one to three kinds of damage."""
    text = URDF
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(("number", "word", "cut", "line", "twice", "swap", "bytes")))
        lines = text.splitlines()
        k = draw(st.integers(0, len(lines) - 1))
        if kind == "number":
            found = list(re.finditer(r'(?<=["\s])-?\d+\.?\d*(?=["\s])', text))
            if found:
                at = draw(st.sampled_from(found))
                text = text[: at.start()] + draw(st.sampled_from(VALUES)) + text[at.end() :]
        elif kind == "word":
            found = list(re.finditer(r"[A-Za-z_]+", text))
            if found:
                at, other = draw(st.sampled_from(found)), draw(st.sampled_from(found))
                text = text[: at.start()] + other.group() + text[at.end() :]
        elif kind == "cut":
            text = text[: draw(st.integers(0, len(text)))]
        elif kind == "line":
            text = "\n".join(lines[:k] + lines[k + 1 :])
        elif kind == "twice":
            text = "\n".join([*lines[: k + 1], *lines[k:]])
        elif kind == "swap":
            other_line = draw(st.integers(0, len(lines) - 1))
            lines[k], lines[other_line] = lines[other_line], lines[k]
            text = "\n".join(lines)
        else:
            raw, at_byte = bytearray(text.encode()), draw(st.integers(0, max(len(text) - 1, 0)))
            if raw:
                raw[at_byte % len(raw)] = draw(st.integers(0, 255))
            return bytes(raw)
        if not text:
            break
    return text.encode()


def check(content: bytes) -> None:
    """Refused in one line that names the file, or an arm that works."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_bytes(content)
        try:
            robot = load_robot(path)
        except ExcitantError as error:
            said = str(error)
            assert "arm.urdf" in said, said
            assert "\n" not in said, said
            assert "Traceback" not in said
            return
    assert robot.nv >= 1
    assert len(set(robot.joints)) == robot.nv
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1, 1, (3, 5, robot.nv))
    motion = Motion(np.arange(5.0), q, dq, ddq)
    assert np.isfinite(robot.phi).all()
    assert np.isfinite(torque(robot, motion)).all()
    low, high = robot.limits.position.T
    assert not (low > high).any()
    assert not (robot.limits.velocity < 0).any()
    assert not (robot.limits.torque < 0).any()


@given(content=damaged())
@example(content=URDF.encode())
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
def test_damaged_descriptions_are_refused_or_work(content: bytes) -> None:
    check(content)


@pytest.mark.slow
@given(content=damaged())
@settings(max_examples=2000, suppress_health_check=[HealthCheck.too_slow])
def test_many_damaged_descriptions_are_refused_or_work(content: bytes) -> None:
    check(content)
