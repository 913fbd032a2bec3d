"""Models from MJCF: MuJoCo has the parts where the model has them, however the file says it; and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import module_requires
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import part_poses
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert, write_model
from micah_plan.exchange.mjcf_reading import load_mjcf

pytestmark = module_requires("sim")
import mujoco

ROOT = Path(__file__).resolve().parents[2]
CABINET = """<mujoco model="cabinet">
  <compiler angle="degree" eulerseq="zyx"/>
  <default><geom rgba="0.2 0.4 0.6 1"/><default class="hinge"><joint axis="0 0 1" range="0 100"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="case" pos="1 0.2 0.4" euler="30 0 0">
      <geom name="wall" type="box" size="0.3 0.2 0.4"/>
      <body name="door" pos="0.3 0.2 0">
        <joint name="door_joint" class="hinge" pos="0 0.01 0" ref="20"/>
        <geom type="box" size="0.02 0.2 0.35" pos="0 -0.2 0"/>
        <site name="door_handle" pos="0.05 -0.35 0.1"/>
        <body name="knob" pos="0.03 -0.35 0"><geom type="capsule" size="0.01 0.03"/></body>
      </body>
      <frame pos="0 0 0.2" euler="0 90 0">
        <body name="drawer" pos="0.1 0 0">
          <joint name="slides" type="slide" axis="0 0 1" range="0 0.35" ref="0.05"/>
          <geom type="box" size="0.1 0.15 0.2"/>
          <geom type="sphere" size="0.02" pos="0 0 0.25" contype="0" conaffinity="0"/>
        </body>
      </frame>
    </body>
  </worldbody>
</mujoco>"""


def loaded(tmp_path: Path, text: str) -> tuple[HybridAutomaton, tuple[str, ...]]:
    (tmp_path / "object.xml").write_text(text)
    return load_mjcf(tmp_path / "object.xml")


def is_as_in_mujoco(automaton: HybridAutomaton, text: str, joints: dict[str, str], seed: int = 0) -> None:
    """At random coordinates; `joints`: names in the file of the coordinates."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mode = automaton.modes[0]
    for state in np.random.default_rng(seed).uniform(-0.5, 0.8, (6, automaton.n)):
        for tie in mode.ties:
            state[tie.coordinate] = tie.value(state)
        for c, value in zip(automaton.coordinates, state, strict=True):
            data.qpos[model.joint(joints.get(c.name, c.name)).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        for part, pose in part_poses(automaton, mode, state).items():
            if part == "base" or part.rpartition("_")[2].isdecimal():  # half of a body with two joints
                continue
            assert_allclose(data.body(part).xpos, pose.translation, atol=1e-9)
            turned = Rotation.from_matrix(data.body(part).xmat.reshape(3, 3)) * pose.rotation.inv()
            assert turned.magnitude() < 1e-8


def test_a_cabinet_of_another_lab(tmp_path: Path) -> None:
    automaton, notes = loaded(tmp_path, CABINET)
    assert [c.name for c in automaton.coordinates] == ["door", "slides"]
    assert [c.unit for c in automaton.coordinates] == ["rad", "m"]
    is_as_in_mujoco(automaton, CABINET, {"door": "door_joint"})
    assert_allclose(automaton.ranges(0), [(0.0, np.deg2rad(100))])
    assert_allclose(automaton.ranges(1), [(0.0, 0.35)])
    door, drawer, base = (automaton.part(name) for name in ("door", "drawer", "base"))
    assert_allclose(door.handle, [0.05, -0.35, 0.1])
    # What is fixed belongs to the part; what only is drawn is left out where something collides.
    assert [shape.kind for shape in door.shapes] == ["box", "cylinder"]
    assert [shape.kind for shape in drawer.shapes] == ["box"]
    assert [shape.kind for shape in base.shapes] == ["box"]
    assert_allclose(door.shapes[0].size, [0.04, 0.4, 0.7])
    assert_allclose(door.shapes[1].size, [0.01, 0.08])
    assert door.shapes[0].color == "#336699"
    assert notes == ("left out: a plane of world",)


def tree(seed: int) -> str:
    """A random tree: up to three joints per body at any place, fixed bodies in between, every kind of orientation."""
    rng = np.random.default_rng(seed)

    def words(values: Any) -> str:
        return " ".join(f"{value:.6g}" for value in np.atleast_1d(values))

    def turned() -> str:
        ways = {
            "quat": rng.normal(size=4),
            "euler": rng.uniform(-180, 180, 3),
            "axisangle": [*rng.normal(size=3), rng.uniform(-180, 180)],
            "xyaxes": rng.normal(size=6),
            "zaxis": rng.normal(size=3),
        }
        way = rng.choice(list(ways))
        return f'{way}="{words(ways[str(way)])}"'

    numbers = iter(range(1, 1000))

    def body(depth: int) -> str:
        name, joints = f"part{next(numbers)}x", ""
        for _ in range(int(rng.integers(0, 3)) if depth < 3 else 1):
            kind = rng.choice(["hinge", "slide"])
            axis, ref = rng.normal(size=3), rng.uniform(-20, 20) if kind == "hinge" else rng.uniform(-0.2, 0.2)
            place = f'pos="{words(rng.normal(size=3))}"' if kind == "hinge" else ""
            joints += f'<joint name="j{next(numbers)}" type="{kind}" axis="{words(axis)}" ref="{ref:.6g}" {place}/>'
        inner = "".join(body(depth - 1) for _ in range(int(rng.integers(1, 3)))) if depth else ""
        return (
            f'<body name="{name}" pos="{words(rng.normal(size=3))}" {turned()}>{joints}<geom size="0.1"/>{inner}</body>'
        )

    sequence = rng.choice(["xyz", "zyx", "XYZ", "zxz"])
    return (
        f'<mujoco><compiler angle="degree" eulerseq="{sequence}"/><option gravity="0 0 0"/>'
        f"<worldbody>{body(3)}</worldbody></mujoco>"
    )


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(12))
def test_random_trees(tmp_path: Path, seed: int) -> None:
    text = tree(seed)
    automaton, _ = loaded(tmp_path, text)
    is_as_in_mujoco(automaton, text, {}, seed)


@pytest.mark.parametrize("name", ["microwave", "drawer", "cabinet"])
def test_what_convert_wrote_comes_back(tmp_path: Path, name: str) -> None:
    original = load_model(ROOT / "models" / f"{name}.yaml")
    convert(ROOT / "models" / f"{name}.yaml", tmp_path / "there.xml")
    convert(tmp_path / "there.xml", tmp_path / "back.yaml")
    again = load_model(tmp_path / "back.yaml")
    assert again.coordinates == original.coordinates
    moving = max(original.modes, key=lambda mode: int(mode.driven.sum()))
    for state in np.random.default_rng(0).uniform(0.0, 0.3, (4, original.n)):
        expected = part_poses(original, moving, state)
        for part, pose in part_poses(again, again.modes[0], state).items():
            assert_allclose(pose.as_matrix(), expected[part].as_matrix(), atol=1e-6)
    # What is fixed to a part, as the cabinet's handle to its door, belongs to it now.
    assert sum(len(part.shapes) for part in again.parts) == sum(len(part.shapes) for part in original.parts)
    for part in again.parts:
        handle = original.part(part.name).handle
        if handle is not None:
            assert_allclose(part.handle, handle, atol=1e-6)


def test_joints_that_follow_others_are_tied(tmp_path: Path) -> None:
    """Two doors of one cupboard, and a hinge with a slide that is a screw: shifts, multipliers, reference positions."""
    text = """<mujoco><compiler angle="radian"/><worldbody>
      <body name="left"><joint name="l" axis="0 0 1" ref="0.1" range="0 1.5" limited="true"/><geom size="0.1"/></body>
      <body name="right" pos="1 0 0"><joint name="r" axis="0 0 1" ref="-0.3"/><geom size="0.1"/></body>
      <body name="bolt" pos="0 1 0"><joint name="in" type="slide" axis="1 0 0"/><joint name="turn" axis="1 0 0"/>
        <geom size="0.1"/></body>
      </worldbody><equality>
      <joint joint1="r" joint2="l" polycoef="0.05 -1 0 0 0"/><joint joint1="in" joint2="turn" polycoef="0 0.01 0 0 0"/>
      </equality></mujoco>"""
    automaton, notes = loaded(tmp_path, text)
    assert notes == ()
    assert [c.name for c in automaton.inputs] == ["l", "turn"]
    is_as_in_mujoco(automaton, text, {})
    # MuJoCo's own constraint holds where the ties do.
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    state = np.zeros(automaton.n)
    state[automaton.index("l")], state[automaton.index("turn")] = 0.7, 0.4
    for tie in automaton.modes[0].ties:
        state[tie.coordinate] = tie.value(state)
    for c, value in zip(automaton.coordinates, state, strict=True):
        data.qpos[model.joint(c.name).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)


def test_a_mesh_is_the_box_around_it(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (0, 2) for y in (0, 4) for z in (0, 1)]
    faces = "1 2 4 3 5 7 8 6 1 5 6 2 3 4 8 7 1 3 7 5 2 6 8 4"
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    numbers = faces.split()
    lines += ["f " + " ".join(numbers[i : i + 4]) for i in range(0, 24, 4)]
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "lid.obj").write_text("\n".join(lines) + "\n")
    text = """<mujoco><compiler meshdir="meshes"/><asset><mesh file="lid.obj" scale="0.1 0.1 0.1"/></asset><worldbody>
      <body name="lid" pos="0 0 1"><joint name="lid_joint" axis="0 1 0"/><geom type="mesh" mesh="lid"/></body>
      </worldbody></mujoco>"""
    automaton, notes = loaded(tmp_path, text)
    (box,) = automaton.part("lid").shapes
    # The sides come in the order of MuJoCo's principal axes; the corners are where the file has them.
    assert sorted(np.round(box.size, 6)) == [0.1, 0.2, 0.4]
    turn, half = Rotation.from_quat(box.quaternion), np.array(box.size) / 2
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    found = np.array(box.position) + turn.apply(signs * half)
    assert_allclose(found.min(axis=0), [0, 0, 0], atol=1e-6)
    assert_allclose(found.max(axis=0), [0.2, 0.4, 0.1], atol=1e-6)
    assert notes == ("body lid: a mesh became the box around it",)


def test_a_free_object_stands_where_the_file_puts_it(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="box" pos="1 2 3"><freejoint/><geom size="0.1"/>
      <body name="lid" pos="0 0 0.2"><joint name="hinge" axis="0 1 0" range="0 90"/><geom size="0.1"/></body>
      </body></worldbody></mujoco>"""
    automaton, notes = loaded(tmp_path, text)
    assert notes == ("the free joint of box is left out: the base frame is where the file puts it",)
    is_as_in_mujoco(automaton, text, {})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "expected a joint that moves"),
        ("<robot/>", "expected <mujoco> (MJCF), found <robot>"),
        ("<mujoco><worldbody><body><joint type='ball'/><geom size='1'/></body></worldbody></mujoco>", "is a ball"),
        ("<mujoco><worldbody><body name='base'><joint/><geom size='1'/></body></worldbody></mujoco>", "called 'base'"),
        ("<mujoco><worldbody><body><joint/><geom size='-1'/></body></worldbody></mujoco>", "cannot be read"),
        ("<mujoco><include file='x.xml'/></mujoco>", "<include>: the file 'x.xml': the file does not exist"),
        ("<mujoco><include file='/etc/passwd'/></mujoco>", "the file '/etc/passwd' lies outside of the folder"),
        ("<mujoco><include file='../x.xml'/></mujoco>", "lies outside of the folder; put it beside or below"),
        ("<mujoco><include/></mujoco>", "the file '' lies outside of the folder"),
        ("<mujoco><include file='object.xml'/></mujoco>", "was included before; include it once"),
        (
            "<mujoco><worldbody><body><joint name='a'/><geom size='1'/><body><joint name='b'/><geom size='1'/></body>"
            "</body></worldbody><equality><joint joint1='a' joint2='b' polycoef='0 1 2 0 0'/></equality></mujoco>",
            "the equality of joint 'a' is no straight line",
        ),
    ],
)  # fmt: skip
def test_what_is_no_model(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        loaded(tmp_path, text)
    assert message in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / "object.xml"))


def test_limits_that_look_like_degrees_are_doubted(tmp_path: Path) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="door"><joint name="hinge" range="0 90"/>
      <geom size="0.1"/></body></worldbody></mujoco>"""
    (note,) = loaded(tmp_path, text)[1]
    assert "limits of 0 to 90 rad are up to 14 turns; if they are degrees" in note
    assert loaded(tmp_path, text.replace("radian", "degree"))[1] == ()


@pytest.mark.parametrize("ending", ["urdf", "xml", "sdf"])
def test_a_model_without_shapes_gets_those_that_are_drawn(tmp_path: Path, ending: str) -> None:
    model = load_model(ROOT / "models" / "drawer.yaml")
    assert write_model(model, tmp_path / f"with.{ending}")[-1].startswith("masses are those of shapes")
    bare = replace(model, parts=tuple(replace(part, shapes=(), handle=None) for part in model.parts))
    notes = write_model(bare, tmp_path / f"bare.{ending}")
    assert notes[-1] == "the model has no shapes: those of the file are made up"
    text = (tmp_path / f"bare.{ending}").read_text()
    assert "box" in text
    assert "damping" in text
    assert ("<gravity>false</gravity>" in text) == (ending == "sdf")
    if ending != "sdf":
        compiled = mujoco.MjModel.from_xml_path(str(tmp_path / f"bare.{ending}"))
        assert compiled.ngeom > 0
        assert compiled.dof_damping[0] == pytest.approx(2.0)


def test_files_that_a_model_includes_are_read_as_mujoco_reads_them(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "door.xml").write_text(
        "<mujocoinclude><body name='door'><joint name='hinge' axis='0 0 1' range='0 90'/>"
        "<geom type='box' size='.2 .01 .3' pos='.2 0 .3'/></body></mujocoinclude>"
    )
    (tmp_path / "defaults.xml").write_text("<mujoco><default><joint damping='1'/></default></mujoco>")
    text = "<mujoco><include file='defaults.xml'/><worldbody><include file='parts/door.xml'/></worldbody></mujoco>"
    automaton, notes = loaded(tmp_path, text)
    assert notes == ()
    assert automaton.coordinate_names == ("hinge",)
    whole = (tmp_path / "parts" / "door.xml").read_text().removeprefix("<mujocoinclude>")
    written_out = f"<mujoco><worldbody>{whole.removesuffix('</mujocoinclude>')}</worldbody></mujoco>"
    assert loaded(tmp_path, written_out)[0] == automaton
    (tmp_path / "defaults.xml").write_text("<robot/>")
    with pytest.raises(InputError, match=r"the file 'defaults\.xml' has the root <robot>; give it <mujocoinclude>"):
        loaded(tmp_path, text)
