"""Robots from files: what they say is what moves, and what is wrong with them is one line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from extras import requires
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_examples import ARM7, SLIDER, TWO_LINKS, arm7, described

from micah_plan.errors import InputError
from micah_plan.robot.load_arm import describe_robot, load_arm
from micah_plan.robot.solids import arm_shapes

MESH = SLIDER.replace('<sphere radius="0.1"/>', '<mesh filename="NAME" scale="0.5 0.5 0.5"/>')
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def told(text: str, tool: str = "finger", **options: object) -> str:
    with pytest.raises(InputError) as caught:
        load_arm(described(text, tool, **options))
    message = str(caught.value)
    assert message.startswith("robot.xml")
    assert "\n" not in message
    return message


def test_the_shipped_arm_has_seven_joints_and_a_hand() -> None:
    arm = arm7()
    assert arm.joints == (
        "shoulder_pan",
        "shoulder_lift",
        "upper_arm_roll",
        "elbow",
        "forearm_roll",
        "wrist_bend",
        "wrist_roll",
    )
    assert np.all(arm.lower < arm.rest)
    assert np.all(arm.rest < arm.upper)
    assert arm.manipulability(arm.rest)[0] > 0.05


@requires("sim")
def test_the_shipped_arm_stands_alike_in_mujoco() -> None:
    import mujoco

    twin = mujoco.MjModel.from_xml_path(str(ARM7))
    data = mujoco.MjData(twin)
    arm = arm7()
    assert (twin.nq, twin.nv) == (9, 9)  # two are the fingers
    chain = [twin.joint(name).id for name in arm.joints]
    np.testing.assert_allclose(twin.jnt_range[chain], np.stack([arm.lower, arm.upper], axis=1), atol=1e-12)
    assert twin.body_mass.sum() == pytest.approx(19.0)
    for q in arm.sample(np.random.default_rng(0), 20):
        data.qpos[chain] = q
        mujoco.mj_kinematics(twin, data)
        body = data.body("tool")
        np.testing.assert_allclose(arm.matrix(q)[:3, 3], body.xpos, atol=1e-12)
        np.testing.assert_allclose(arm.matrix(q)[:3, :3], body.xmat.reshape(3, 3), atol=1e-12)


@requires("sim")
def test_an_mjcf_arm_stands_alike_in_mujoco_and_its_other_joints_are_held() -> None:
    import mujoco

    twin = mujoco.MjModel.from_xml_string(TWO_LINKS)
    data = mujoco.MjData(twin)
    arm = load_arm(described(TWO_LINKS, "tool"))
    assert arm.joints == ("shoulder", "elbow")
    np.testing.assert_allclose(arm.upper, [2.0, 2.0])
    for q in arm.sample(np.random.default_rng(0), 20):
        data.qpos[:2] = q
        mujoco.mj_kinematics(twin, data)
        np.testing.assert_allclose(arm.matrix(q)[:3, 3], data.site("tool").xpos, atol=1e-12)
        np.testing.assert_allclose(arm.matrix(q)[:3, :3], data.site("tool").xmat.reshape(3, 3), atol=1e-12)
    jaw = next(item for item in arm.geometry.geometryObjects if item.name.startswith("jaw"))
    assert jaw.placement.translation[0] == pytest.approx(0.02)  # the middle of its range
    shut = load_arm(described(TWO_LINKS, "tool", locked=(("grip", 0.0),)))
    jaw = next(item for item in shut.geometry.geometryObjects if item.name.startswith("jaw"))
    assert jaw.placement.translation[0] == pytest.approx(0.0, abs=1e-15)


def test_a_joint_without_limits_is_an_angle() -> None:
    arm = load_arm(described(SLIDER, "finger"))
    assert arm.joints == ("slide", "turn")
    np.testing.assert_array_equal(arm.lower, [-0.4, -np.inf])
    np.testing.assert_array_equal(arm.upper, [0.5, np.inf])
    np.testing.assert_allclose(
        arm.matrix(np.array([0.1, 7.0])), arm.matrix(np.array([0.1, 7.0 - 2 * np.pi])), atol=1e-12
    )


def test_the_base_pose_moves_everything() -> None:
    turned = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    plain = load_arm(described(SLIDER, "finger"))
    placed = load_arm(described(SLIDER, "finger", position=(1.0, 2.0, 3.0), quaternion=turned))
    base = np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]])
    q = np.array([0.2, -1.0])
    np.testing.assert_allclose(placed.matrix(q), base @ plain.matrix(q), atol=1e-12)
    rail = next(shape for joint, shape in arm_shapes(placed) if joint == 0)
    np.testing.assert_allclose(rail.position, [1.0, 2.0, 3.0])


def test_meshes_become_their_convex_hulls(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    arm = load_arm(described(MESH.replace("NAME", "t.obj"), "finger", folder=str(tmp_path)))
    hull = next(shape for _, shape in arm_shapes(arm) if hasattr(shape, "vertices"))
    assert {tuple(vertex) for vertex in hull.vertices} == {(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0), (0, 0, 0.5)}


def test_packages_are_given_or_stand_above_the_file(tmp_path: Path) -> None:
    inside = tmp_path / "mypkg" / "urdf"
    inside.mkdir(parents=True)
    (tmp_path / "mypkg" / "t.obj").write_text(TETRAHEDRON)
    text = MESH.replace("NAME", "package://mypkg/t.obj")
    assert load_arm(described(text, "finger", folder=str(inside))).n == 2
    other = text.replace("mypkg", "other")
    assert load_arm(described(other, "finger", packages=(("other", str(tmp_path / "mypkg")),))).n == 2
    assert "package 'other' is not known" in told(other, folder=str(inside))


@pytest.mark.parametrize(
    "name",
    ["../t.obj", "/etc/passwd", "a/../../t.obj", "link.obj", "package://pkg/../t.obj", "file:///t.obj", "", "no.obj"],
)
def test_mesh_paths_may_not_leave_their_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    folder = tmp_path / "pkg"
    folder.mkdir()
    os.symlink(tmp_path / "t.obj", folder / "link.obj")
    message = told(MESH.replace("NAME", name), folder=str(folder))
    assert "line 3, <mesh>" in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("</robot>", "", "not valid XML: no element found"),
        (
            '<robot name="slider">',
            '<!-- by hand -->\n<?xml version="1.0"?><robot name="slider">',
            "put <?xml ...?> first",
        ),
        ('<robot name="slider">', '<!DOCTYPE robot [<!ENTITY a "b">]><robot>', "entities are not allowed"),
        ('name="cart"', 'name="rail"', "line 3, <link>: link 'rail' is there already, on line 2"),
        ('child link="wheel"', 'child link="rail"', "one tree of links"),
        ('child link="wheel"', 'child link="cart"', "'cart' is carried by two joints"),
        (
            'child link="wheel"',
            'child link="weel"',
            "line 8, <child>: expected the name of a link",
        ),
        ('type="continuous"', 'type="floating"', "expected a joint of type revolute"),
        ('xyz="0.48 0.64 0.6"', 'xyz="0 0 0"', "an axis that is not zero"),
        ('xyz="0.48 0.64 0.6"', 'xyz="0 nan 0"', "expected 3 numbers for 'xyz'"),
        ('upper="0.5"', 'upper="-0.5"', "expected lower < upper, found -0.4 and -0.5"),
        ('upper="0.5"', 'upper="inf"', "expected a number for 'upper'"),
        ('<limit lower="-0.4" upper="0.5"/>', "", "missing <limit> of a prismatic joint"),
        ('size="1 0.1 0.1"', 'size="1 0.1"', "expected 3 numbers for 'size', found '1 0.1'"),
        ('radius="0.2"', 'radius="-0.2"', "expected 'radius' > 0"),
        ('<sphere radius="0.1"/>', '<ball radius="0.1"/>', "expected a box, cylinder, capsule, sphere or mesh"),
        ('rpy="0.4 0 0"', 'rpy="1e999 0 0"', "expected 3 numbers for 'rpy'"),
        ("<axis xyz", '<mimic joint="slide"/><axis xyz', "follows another one and moves the tool"),
    ],
)
def test_mistakes_are_reported_with_their_line(old: str, new: str, expected: str) -> None:
    assert old in SLIDER
    assert expected in told(SLIDER.replace(old, new, 1))


def test_unknown_names_and_bad_postures_are_reported() -> None:
    assert "expected <robot> (URDF) or <mujoco> (MJCF), found <sdf>" in told("<sdf/>")
    assert "no frame 'hand' to hold with; choose one, for instance of" in told(SLIDER, "hand")
    assert "no joint moves the frame 'rail'" in told(SLIDER, "rail")
    assert "no joint 'lift'; choose one of slide, turn" in told(SLIDER, rest=(("lift", 0.0),))
    assert "'slide' at 2, outside -0.4 to 0.5" in told(SLIDER, rest=(("slide", 2.0),))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<worldbody>", '<include file="/etc/passwd"/><worldbody>', "<include> is not read"),
        ("<worldbody>", '<asset><mesh name="m" file="../m.stl"/></asset><worldbody>', "leaves its folder"),
        ('range="-2 2"', 'range="-2 nan"', "expected numbers for 'range'"),
        ('type="hinge" axis="1 0 0" range="-1 2"', 'type="ball"', "is of kind"),
    ],
)
def test_mistakes_in_mjcf_are_reported(old: str, new: str, expected: str, tmp_path: Path) -> None:
    assert expected in told(TWO_LINKS.replace(old, new, 1), "tool", folder=str(tmp_path))


def test_deep_and_large_files_are_refused() -> None:
    assert "levels deep" in told("<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>")
    assert "at most 50000 elements" in told("<robot>" + "<a/>" * 60000 + "</robot>")


@settings(max_examples=150)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_in_one_line(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from([SLIDER, TWO_LINKS]))
    words = text.split('"')
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(words) // 2 - 1)) * 2 + 1
        junk = st.sampled_from(["", "0", "-1", "1e30", "nan", "a b", "0 0 0", "rail", "hinge", "free", "1e308 1 1"])
        words[index] = data.draw(junk | st.text(max_size=8).filter(lambda t: '"' not in t))
    try:
        joints = load_arm(described('"'.join(words), "finger" if text is SLIDER else "tool")).n
    except InputError as error:
        joints, message = 0, str(error)
    assert joints >= 1 or "\n" not in message


def test_numbers_that_only_python_reads_lose_no_shape(capfd: pytest.CaptureFixture[str]) -> None:
    """With a blank behind a radius, the parser of URDF would say so on stderr and leave the shape out."""
    good = ARM7.read_text()
    changed = good.replace('radius="0.05"', 'radius="0.0_5 "')
    assert changed != good
    assert load_arm(described(changed, "tool")).geometry.ngeoms == load_arm(described(good, "tool")).geometry.ngeoms
    assert capfd.readouterr() == ("", "")


SAME_NAMES = """<robot name="r">
  <link name="base"/>
  <link name="arm"/>
  <link name="gripper"/>
  <link name="jaw"/>
  <joint name="arm" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="revolute"><parent link="arm"/><child link="gripper"/><origin xyz="0.2 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="gripper" type="revolute"><parent link="gripper"/><child link="jaw"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


@pytest.mark.parametrize("tool", ["gripper", "arm", "jaw"])
def test_joints_and_links_may_have_the_same_names(tmp_path: Path, tool: str) -> None:
    """As in the files of LeRobot's arms; the tool is the link, which Pinocchio's own kinematics places."""
    import pinocchio

    (tmp_path / "r.urdf").write_text(SAME_NAMES)
    arm = load_arm(describe_robot(tmp_path / "r.urdf", tool))
    assert arm.joints == {"gripper": ("arm", "wrist"), "arm": ("arm",), "jaw": ("arm", "wrist", "gripper")}[tool]
    whole = pinocchio.buildModelFromXML(SAME_NAMES)
    data, q = whole.createData(), np.zeros(3)
    q[: len(arm.joints)] = [0.4, -0.3, 0.2][: len(arm.joints)]
    pinocchio.framesForwardKinematics(whole, data, q)
    place = data.oMf[whole.getFrameId(tool, pinocchio.FrameType.BODY)]
    np.testing.assert_allclose(arm.matrix(q[: len(arm.joints)]), place.homogeneous, atol=1e-12)
    assert sorted(frame.name for frame in arm.model.frames) == sorted(frame.name for frame in whole.frames)


def test_a_robot_keeps_the_text_of_what_it_includes(tmp_path: Path) -> None:
    body, rest = TWO_LINKS.split("<worldbody>")[1].split("</worldbody>")
    (tmp_path / "links.xml").write_text(f"<mujocoinclude>{body}</mujocoinclude>")
    head = TWO_LINKS.split("<worldbody>")[0]
    (tmp_path / "robot.xml").write_text(f'{head}<worldbody><include file="links.xml"/></worldbody>{rest}')
    (tmp_path / "whole.xml").write_text(TWO_LINKS)
    found, whole = (describe_robot(tmp_path / name, "tool") for name in ("robot.xml", "whole.xml"))
    (tmp_path / "links.xml").unlink()  # a plan is executed without the file
    arm, same = load_arm(found), load_arm(whole)
    assert arm.joints == same.joints
    np.testing.assert_allclose(arm.matrix(arm.rest), same.matrix(same.rest))
