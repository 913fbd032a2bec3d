"""Models to and from URDF: Pinocchio finds the parts where the model does, round trips, what URDF cannot say."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.transition import step
from micah_plan.documents.model import load_model, model_text
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.exchange.urdf import load_urdf, urdf_text
from micah_plan.robot.robot_text import check_urdf
from micah_plan.xml_text import parse_xml

ROOT = Path(__file__).resolve().parents[2]
MODELS = ["microwave", "drawer", "cabinet", "slot", "light_dark"]


def moving(automaton: HybridAutomaton, k: int) -> Joint:
    return max((mode.joints[k] for mode in automaton.modes), key=lambda joint: joint.kind != "rigid")


def part_poses(automaton: HybridAutomaton, state: np.ndarray) -> dict[str, RigidTransform]:
    poses = {"base": RigidTransform.identity()}
    for k, link in enumerate(automaton.links):
        poses[link.child] = poses[link.parent] * forward(moving(automaton, k), state[link.coordinate])[0]
    return poses


@pytest.mark.parametrize("name", MODELS)
def test_pinocchio_finds_the_parts_where_the_model_does(name: str) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    robot = pin.buildModelFromXML(urdf_text(automaton, name))
    data = robot.createData()
    parts = {link.child for link in automaton.links}
    joints = [f"{c.name}_joint" if c.name in parts else c.name for c in automaton.coordinates]
    order = [robot.joints[robot.getJointId(name)].idx_q for name in joints]
    for state in np.random.default_rng(0).uniform(0.0, 1.0, (5, automaton.n)):
        q = np.zeros(robot.nq)
        q[order] = state
        pin.framesForwardKinematics(robot, data, q)
        for part, pose in part_poses(automaton, state).items():
            found = data.oMf[robot.getFrameId(part)]  # one frame of that name, whatever its kind
            np.testing.assert_allclose(found.homogeneous, pose.as_matrix(), atol=1e-9)
    for index, at in enumerate(order):
        ranges = np.clip(automaton.ranges(index), -1e9, 1e9)
        np.testing.assert_allclose(
            [robot.lowerPositionLimit[at], robot.upperPositionLimit[at]], [ranges[0][0], ranges[-1][1]]
        )


@pytest.mark.parametrize("name", MODELS)
def test_a_converted_model_moves_alike_and_has_its_shapes(tmp_path: Path, name: str) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    (tmp_path / "m.urdf").write_text(urdf_text(automaton, name))
    found, notes = load_urdf(tmp_path / "m.urdf")
    assert notes == ()
    assert [c.name for c in found.coordinates] == [c.name for c in automaton.coordinates]
    assert [c.unit for c in found.coordinates] == [c.unit for c in automaton.coordinates]
    state = np.linspace(0.1, 0.3, automaton.n)
    again = part_poses(found, state)
    for part, pose in part_poses(automaton, state).items():
        if part not in again:
            assert part == "handle"
            continue
        np.testing.assert_allclose(again[part].as_matrix(), pose.as_matrix(), atol=1e-9)
    shapes = {part.name: part.shapes for part in automaton.parts if part.shapes}
    kept = {part.name: part.shapes for part in found.parts if part.shapes}
    assert sum(map(len, shapes.values())) == sum(map(len, kept.values()))
    for part in shapes.keys() & kept.keys() - {"door"}:  # a cabinet's handle is now of the door that it is fixed to
        for before, after in zip(shapes[part], kept[part], strict=True):
            assert (after.kind, after.size, after.color.lower()) == (before.kind, before.size, before.color.lower())
            np.testing.assert_allclose(after.position, before.position, atol=1e-12)
    (tmp_path / "again.urdf").write_text(urdf_text(found, name))
    third, _ = load_urdf(tmp_path / "again.urdf")
    for first, last in zip(found.modes[0].joints, third.modes[0].joints, strict=True):
        for key in ("position", "quaternion", "axis", "center"):
            np.testing.assert_allclose(getattr(last, key), getattr(first, key), atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_parts_have_the_mass_of_their_shapes(name: str) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    light, heavy = (pin.buildModelFromXML(urdf_text(automaton, name, density)) for density in (100.0, 700.0))
    assert len({frame.name for frame in heavy.frames}) == len(heavy.frames), "every frame has a name of its own"
    data = heavy.createData()
    assert np.linalg.eigvalsh(pin.crba(heavy, data, pin.neutral(heavy))).min() > 0
    shaped = [k for k, link in enumerate(automaton.links) if automaton.part(link.child).shapes]
    if len(shaped) == len(automaton.links):
        assert pin.computeTotalMass(heavy) == pytest.approx(7.0 * pin.computeTotalMass(light))


def test_limits_stop_the_motion(tmp_path: Path) -> None:
    from micah_plan.automaton.transition import simulate

    convert(ROOT / "models" / "drawer.yaml", tmp_path / "d.urdf")
    convert(tmp_path / "d.urdf", tmp_path / "d.yaml")
    model = load_model(tmp_path / "d.yaml")
    (low, high) = model.ranges(0)[0]
    run = simulate(model, "moves", [0.1], np.array([[0.3], [-0.1], [-0.5]]))
    np.testing.assert_allclose(run.states[:, 0], [0.1, high, high - 0.1, low], atol=1e-12)


def test_an_arm_is_a_model_too() -> None:
    automaton, notes = load_urdf(ROOT / "models" / "robots" / "arm7.urdf")
    assert automaton.n == 9  # seven of the arm, and two fingers
    assert notes == ()
    hand = next(part for part in automaton.parts if part.name == "flange")
    assert len(hand.shapes) == 2  # the flange itself and the palm are fixed to one another
    robot = pin.buildModelFromUrdf(str(ROOT / "models" / "robots" / "arm7.urdf"))
    q = np.append(np.linspace(-0.5, 0.7, 7), [0.01, 0.01])
    pin.framesForwardKinematics(robot, data := robot.createData(), q)
    pose = part_poses(automaton, q)["flange"].as_matrix()
    np.testing.assert_allclose(data.oMf[robot.getFrameId("flange")].homogeneous, pose, atol=1e-9)
    assert load_model_text(model_text(automaton)) == automaton


def load_model_text(text: str) -> HybridAutomaton:
    from micah_plan.documents.model import usable_model

    return usable_model(text.encode(), "m.yaml")


LINK = '<link name="{}"><collision><geometry>{}</geometry></collision></link>'
HINGE = '<joint name="h" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{}</joint>'


def urdf(tmp_path: Path, shape: str = '<sphere radius="1"/>', more: str = "", joint: str = HINGE) -> Path:
    links = LINK.format("a", '<sphere radius="1"/>') + LINK.format("b", shape)
    text = f"<robot name='r'>{links}{joint.format(more)}</robot>"
    (tmp_path / "r.urdf").write_text(text)
    return tmp_path / "r.urdf"


def test_capsules_become_solids_and_meshes_are_reported(tmp_path: Path) -> None:
    found, _ = load_urdf(urdf(tmp_path, '<capsule radius="0.1" length="0.4"/>'))
    assert [shape.kind for shape in found.parts[1].shapes] == ["cylinder", "sphere", "sphere"]
    assert found.modes[0].invariant.half_spaces == ()
    (tmp_path / "m.stl").write_text("solid")
    found, notes = load_urdf(urdf(tmp_path, '<mesh filename="m.stl"/>'))
    assert found.parts[1].shapes == ()
    assert notes == ("link b: a mesh is left out, expected a mesh, found no corners",)


@pytest.mark.parametrize(
    ("limit", "why"),
    [
        ('<limit effort="5" velocity="2"/>', "without lower and upper both are 0; give them, or the type continuous"),
        ('<limit lower="0.3" upper="0.3"/>', "lower and upper are both 0.3"),
    ],
)
def test_a_joint_that_cannot_move_is_fixed_in_an_object_and_reported(tmp_path: Path, limit: str, why: str) -> None:
    stiff = HINGE.replace("continuous", "revolute").format(limit)
    knob = HINGE.format("").replace('"h"', '"k"').replace('"a"', '"b"').replace('link="b"/><axis', 'link="c"/><axis')
    path = urdf(tmp_path, joint=stiff.replace("{", "{{"))
    with pytest.raises(InputError, match="expected a joint that moves, found none"):
        load_urdf(path)
    more = path.read_text().replace("</robot>", LINK.format("c", '<sphere radius="1"/>') + knob + "</robot>")
    path.write_text(more)
    found, notes = load_urdf(path)
    assert [c.name for c in found.coordinates] == ["k"]
    assert f"joint h is fixed: {why}" in notes
    with pytest.raises(InputError, match="expected lower < upper"):  # an arm would not reach
        check_urdf(parse_xml(more, str(path)), str(tmp_path), {})


def test_a_shape_that_is_no_solid_is_left_out_and_reported(tmp_path: Path) -> None:
    found, notes = load_urdf(urdf(tmp_path, '<plane normal="0 0 1"/>'))
    assert found.parts[1].shapes == ()
    assert notes == ("link b: <plane> is left out, it is no solid",)


PARTNET = """<robot name="partnet_1">
  <link name="base"/>
  <link name="link_0">
    <visual name="handle-3">
      <origin xyz="0.4 0 0.2"/><geometry><mesh filename="textured_objs/original-2.obj"/></geometry>
    </visual>
    <visual name="door_frame-1">
      <origin xyz="0.4 0 0.2"/><geometry><mesh filename="textured_objs/original-1.obj"/></geometry>
    </visual>
    <collision><origin xyz="0.4 0 0.2"/><geometry><mesh filename="textured_objs/original-1.obj"/></geometry></collision>
    <collision><origin xyz="0.4 0 0.2"/><geometry><mesh filename="textured_objs/original-2.obj"/></geometry></collision>
  </link>
  <joint name="joint_0" type="revolute">
    <origin xyz="-0.4 0 -0.2"/><axis xyz="0 -1 0"/><child link="link_0"/><parent link="link_1"/>
    <limit lower="0" upper="1.57"/>
  </joint>
  <link name="link_1">
    <visual name="frame-2"><geometry><mesh filename="textured_objs/original-3.obj"/></geometry></visual>
    <collision><geometry><mesh filename="textured_objs/original-3.obj"/></geometry></collision>
  </link>
  <joint name="joint_1" type="fixed">
    <origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/><child link="link_1"/><parent link="base"/>
  </joint>
</robot>"""
BOXES = {
    1: ((-0.4, -0.5, 0.2), (0.4, 0.5, 0.22)),
    2: ((0.3, -0.1, 0.22), (0.35, 0.1, 0.26)),
    3: ((-0.4, -0.5, -0.3), (0.4, 0.5, 0.2)),
}


def test_an_object_of_partnet_mobility_is_made_of_boxes_and_has_its_handle(tmp_path: Path) -> None:
    """A door in the layout of that data set: y up in the meshes, a fixed joint that turns it, meshes called handle."""
    (tmp_path / "textured_objs").mkdir()
    for number, ends in BOXES.items():
        corners = product(*zip(*ends, strict=True))
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        (tmp_path / "textured_objs" / f"original-{number}.obj").write_text("\n".join([*lines, "f 1 2 3"]))
    (tmp_path / "mobility.urdf").write_text(PARTNET)
    found, notes = load_urdf(tmp_path / "mobility.urdf")
    assert notes == (
        "link link_1: a mesh became the box around it",
        "link link_0: 2 meshes became the boxes around them",
    )
    base, door = found.parts
    assert (base.name, door.name, found.ranges(0)) == ("base", "link_0", [(0.0, 1.57)])
    pose = forward(found.modes[0].joints[0], np.zeros(1))
    turned = Rotation.from_euler("xyz", [np.pi / 2, 0.0, -np.pi / 2])
    for shape, number in zip(door.shapes, (1, 2), strict=True):
        middle = pose.apply(np.array(shape.position))[0]
        np.testing.assert_allclose(middle, turned.apply(np.mean(BOXES[number], axis=0)), atol=1e-9)
        np.testing.assert_allclose(shape.size, np.ptp(BOXES[number], axis=0), atol=1e-9)
    assert door.handle == door.shapes[1].position
    assert base.shapes[0].size == pytest.approx((0.8, 1.0, 0.5))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"more": '<mimic joint="x"/>'}, "expected the name of a joint, found 'x'"),
        ({"more": '<mimic joint="h"/>'}, "joint 'h' follows itself"),
        ({"joint": HINGE.replace("continuous", "fixed")}, "expected a joint that moves, found none"),
        ({"joint": HINGE.replace("continuous", "floating")}, "expected a joint of type"),
        ({"joint": ""}, "expected one tree of links"),
    ],
)
def test_what_no_model_can_contain_is_one_line(tmp_path: Path, changes: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        load_urdf(urdf(tmp_path, **changes))
    assert str(caught.value).startswith(str(tmp_path / "r.urdf"))


WINGS = """<robot name="wings">
  <link name="body"/><link name="left"/><link name="right"/><link name="tip"/>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="left"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1.5"/></joint>
  <joint name="other" type="revolute"><parent link="body"/><child link="right"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1"/><mimic joint="hinge" multiplier="-0.5" offset="0.1"/></joint>
  <joint name="last" type="prismatic"><parent link="right"/><child link="tip"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1"/><mimic joint="other" multiplier="0.2"/></joint>
</robot>"""


def test_joints_that_follow_another_one_are_tied_to_it(tmp_path: Path) -> None:
    (tmp_path / "wings.urdf").write_text(WINGS)
    found, _ = load_urdf(tmp_path / "wings.urdf")
    assert (found.coordinate_names, found.input_names) == (("hinge", "other", "last"), ("hinge",))
    for start, command in ((0.3, 0.2), (1.4, 0.3), (0.1, -0.4)):
        end = step(found, "moves", [start, 0.1 - 0.5 * start, 0.2 * (0.1 - 0.5 * start)], [command]).x
        hinge = float(np.clip(start + command, 0.0, 1.5))
        assert end == pytest.approx([hinge, 0.1 - 0.5 * hinge, 0.2 * (0.1 - 0.5 * hinge)])
    (tmp_path / "again.urdf").write_text(urdf_text(found, "wings"))
    again, _ = load_urdf(tmp_path / "again.urdf")
    assert again.modes[0].ties == found.modes[0].ties
    assert again.input_names == found.input_names


@pytest.mark.parametrize("limit", ["", '<limit effort="5" velocity="2"/>', '<limit lower="-1" upper="1"/>'])
def test_a_follower_goes_where_its_leader_does_without_limits_too(tmp_path: Path, limit: str) -> None:
    path = tmp_path / "wings.urdf"
    path.write_text(WINGS.replace('<limit lower="-1" upper="1"/>', limit))
    found, notes = load_urdf(path)
    assert not notes
    end = step(found, "moves", [0.3, -0.05, -0.01], [0.4]).x
    robot = pin.buildModelFromXML(WINGS.replace("<limit ", '<limit effort="1" velocity="1" '))
    data, q = robot.createData(), np.zeros(robot.nq)
    for name, value in (("hinge", 0.7), ("other", 0.1 - 0.35), ("last", 0.2 * (0.1 - 0.35))):
        q[robot.joints[robot.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(robot, data, q)
    expected = data.oMf[robot.getFrameId("tip")].homogeneous
    np.testing.assert_allclose(part_poses(found, end)["tip"].as_matrix(), expected, atol=1e-9)
    path.write_text(WINGS.replace('<limit lower="0" upper="1.5"/>', '<limit effort="5" velocity="2"/>'))
    with pytest.raises(InputError, match="joint 'other' follows 'hinge', which does not move"):
        load_urdf(path)
    path.write_text(WINGS.replace('<limit lower="-1" upper="1"/>', '<limit lower="0.1" upper="0.1"/>'))
    with pytest.raises(InputError, match="joint 'last' follows 'other', which does not move"):
        load_urdf(path)


def test_meshes_that_are_not_there_are_left_out_and_reported(tmp_path: Path) -> None:
    names = ("package://nowhere/m.stl", "missing.stl", "file:///somewhere/else/m.stl", "../../etc/passwd")
    for name in names:
        found, notes = load_urdf(urdf(tmp_path, f'<mesh filename="{name}"/>'))
        assert found.parts[1].shapes == ()
        assert len(notes) == 1
        assert notes[0].startswith("link b: a mesh is left out, ")


CORNERS = "\n".join(f"v {x} {y} {z}" for x, y, z in product((0, 1), repeat=3)) + "\nf 1 2 3\n"


@pytest.mark.parametrize("name", ["package://things/m.obj", "file://{folder}/m.obj", "m.obj"])
def test_meshes_are_found_in_packages_and_by_uri(tmp_path: Path, name: str) -> None:
    (tmp_path / "m.obj").write_text(CORNERS)
    path = urdf(tmp_path, f'<mesh filename="{name.format(folder=tmp_path)}" scale="0.1 0.1 0.1"/>')
    found, _ = load_urdf(path, {"things": str(tmp_path)})
    assert found.parts[1].shapes[0].size == pytest.approx((0.1, 0.1, 0.1))


def test_limits_in_degrees_and_meshes_in_millimetres_are_doubted(tmp_path: Path) -> None:
    limited = HINGE.replace("continuous", "revolute")
    for upper, doubted in ((90, True), (1.57, False), (7.0, False)):
        path = urdf(tmp_path, joint=limited.replace("</joint>", f'<limit lower="0" upper="{upper}"/></joint>'))
        assert any("degrees" in note for note in load_urdf(path)[1]) is doubted
    (tmp_path / "m.obj").write_text(CORNERS)
    for scale, doubted in ((100, True), (1, False)):
        path = urdf(tmp_path, f'<mesh filename="m.obj" scale="{scale} {scale} {scale}"/>')
        assert any("mm" in note for note in load_urdf(path)[1]) is doubted


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (("</robot>", '<link name="b"/></robot>'), "link 'b' is there already, on line"),
        (("<robot ", "<robot xmlns:xacro='x' "), "links"),
        (("</robot>", '<xacro:door side="left"/></robot>'), "this is xacro, not yet a URDF; expand it"),
        (('name="b"', 'name="${side}"'), "this is xacro"),
    ],
)
def test_what_is_wrong_with_names_is_reported_with_its_line(
    tmp_path: Path, changed: tuple[str, str], said: str
) -> None:
    path = urdf(tmp_path)
    text = path.read_text()
    path.write_text(text.replace(*changed, 1))
    if said == "links":  # a namespace alone is no xacro
        load_urdf(path)
        return
    with pytest.raises(InputError, match=said):
        load_urdf(path)


def test_what_urdf_cannot_express_is_refused() -> None:
    drawer = load_model(ROOT / "models" / "drawer.yaml")
    turned = replace(drawer.modes[0], joints=(screw((0, 0, 1), (0, 0, 0), 0.1, (1, 0, 0)),))
    with pytest.raises(InputError, match="part drawer moves on a screw"):
        urdf_text(replace(drawer, modes=(turned,)), "r")
    other = replace(drawer.modes[0], name="other", joints=(replace(drawer.modes[0].joints[0], position=(1, 0, 0)),))
    with pytest.raises(InputError, match="different joints in different modes"):
        urdf_text(replace(drawer, modes=(*drawer.modes, other)), "r")


@pytest.mark.slow
def test_the_command_converts_and_refuses_what_does_not_fit(tmp_path: Path) -> None:
    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "micah_plan", "convert", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    box = ROOT / "examples" / "demonstrations" / "box.csv"
    done = run(box, tmp_path / "box.npz", "--json")
    assert json.loads(done.stdout)["kind"] == "recording"
    for source, target, said in (
        (box, tmp_path / "box.yaml", "must end in .csv or .npz"),
        (ROOT / "README.md", tmp_path / "x.csv", "there is no conversion of a '.md' file"),
        (tmp_path / "box.usda", tmp_path / "box.yaml", "a USD file is not read; export the object as URDF or MJCF"),
        (box, box, "would overwrite an input"),
    ):
        refused = run(source, target)
        assert refused.returncode == 2
        assert said in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
