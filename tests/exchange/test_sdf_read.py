"""Models from SDF: Drake has the parts where the model has them, however the file says it; and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import part_poses
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.exchange.sdf import sdf_text
from micah_plan.exchange.sdf_read import load_sdf

ROOT = Path(__file__).resolve().parents[2]
INERTIAL = (
    "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz>"
    "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
)
CABINET = f"""<?xml version="1.0"?>
<sdf version="1.9">
  <model name="cabinet">
    <frame name="corner" attached_to="case"><pose degrees="true">0.3 0.2 -0.1 0 0 40</pose></frame>
    <link name="case">
      <pose>0.1 0.2 0.4 0.3 0 0</pose>{INERTIAL}
      <collision name="c"><geometry><box><size>0.6 0.4 0.8</size></box></geometry></collision>
    </link>
    <link name="door">
      <pose relative_to="hinge">0 -0.2 0 0 0 0.5</pose>{INERTIAL}
      <visual name="v"><geometry><box><size>0.02 0.4 0.7</size></box></geometry>
        <material><diffuse>0.2 0.4 0.6 1</diffuse></material></visual>
      <collision name="c"><pose>0 -0.2 0 0 0 0</pose>
        <geometry><box><size>0.02 0.4 0.7</size></box></geometry></collision>
    </link>
    <link name="knob">
      <pose relative_to="door" rotation_format="quat_xyzw">0.03 -0.35 0 0 0 0.6 0.8</pose>{INERTIAL}
      <collision name="c"><geometry><sphere><radius>0.02</radius></sphere></geometry></collision>
    </link>
    <link name="tray">
      <pose relative_to="case">0.1 0 0.2 0 0.7 0</pose>{INERTIAL}
      <collision name="c">
        <geometry><cylinder><radius>0.1</radius><length>0.05</length></cylinder></geometry></collision>
    </link>
    <joint name="stands" type="fixed"><parent>world</parent><child>case</child></joint>
    <joint name="hinge" type="revolute">
      <pose relative_to="corner">0 0.01 0 0 0.2 0</pose>
      <parent>case</parent><child>door</child>
      <axis><xyz expressed_in="case">0 0.6 0.8</xyz><limit><lower>0</lower><upper>1.6</upper></limit></axis>
    </joint>
    <joint name="holds" type="fixed"><parent>door</parent><child>knob</child></joint>
    <joint name="slides" type="prismatic">
      <parent>case</parent><child>tray</child>
      <axis><xyz>0 0 2</xyz><limit><lower>-0.05</lower><upper>0.3</upper></limit></axis>
    </joint>
  </model>
</sdf>"""


def loaded(tmp_path: Path, text: str) -> tuple[HybridAutomaton, tuple[str, ...]]:
    (tmp_path / "object.sdf").write_text(text)
    return load_sdf(tmp_path / "object.sdf")


def is_as_in_drake(automaton: HybridAutomaton, text: str) -> None:
    """At random coordinates."""
    plant_of = pytest.importorskip("pydrake.multibody.plant", reason="Drake reads SDF: pip install drake")
    from pydrake.multibody.parsing import Parser

    plant = plant_of.MultibodyPlant(0.001)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    context, mode = plant.CreateDefaultContext(), automaton.modes[0]
    for state in np.random.default_rng(0).uniform(0.0, 0.3, (5, automaton.n)):
        positions = plant.GetPositions(context)
        for i, coordinate in enumerate(automaton.coordinates):
            positions[plant.GetJointByName(coordinate.name).position_start()] = state[i]
        plant.SetPositions(context, positions)
        for part, pose in part_poses(automaton, mode, state).items():
            there = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(part))
            assert_allclose(there.GetAsMatrix4(), pose.as_matrix(), atol=1e-9)


def test_drake_has_the_parts_where_the_model_has_them(tmp_path) -> None:
    automaton, notes = loaded(tmp_path, CABINET)
    assert [c.name for c in automaton.coordinates] == ["hinge", "slides"]
    assert automaton.ranges(0) == [(0.0, 1.6)]
    assert automaton.ranges(1) == [(-0.05, 0.3)]
    assert notes == ()
    assert [shape.kind for shape in automaton.part("door").shapes] == ["box", "sphere"]  # the knob is fixed to it
    assert automaton.part("door").shapes[0].color == "#336699"
    is_as_in_drake(automaton, CABINET)


def test_the_axis_is_where_the_file_says(tmp_path) -> None:
    """Without Drake: the hinge, computed by hand."""
    automaton, _ = loaded(tmp_path, CABINET)
    case, tilt = np.array([0.1, 0.2, 0.4]), Rotation.from_euler("x", 0.3)
    corner = Rotation.from_euler("z", 40, degrees=True)
    hinge, _ = automaton.modes[0].joints
    assert_allclose(hinge.axis, tilt.apply([0.0, 0.6, 0.8]), atol=1e-12)
    through = case + tilt.apply(np.array([0.3, 0.2, -0.1]) + corner.apply([0.0, 0.01, 0.0]))
    away = np.subtract(hinge.center, through)
    assert_allclose(np.cross(away, hinge.axis), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["microwave", "drawer", "cabinet", "slot"])
def test_our_own_come_back(tmp_path, name) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    again, notes = loaded(tmp_path, sdf_text(automaton, "object", 700.0))
    assert notes == ()
    assert again.coordinate_names == automaton.coordinate_names
    moving = max(automaton.modes, key=lambda mode: int(mode.driven.sum()))
    for state in np.random.default_rng(0).uniform(0.0, 0.3, (5, automaton.n)):
        there = part_poses(again, again.modes[0], state)
        here = part_poses(automaton, moving, state)
        assert here.keys() - there.keys() <= {"handle"}  # what is fixed to a part is of it
        for part, pose in there.items():
            assert_allclose(pose.as_matrix(), here[part].as_matrix(), atol=1e-9)
    for i in range(automaton.n):
        low, high = again.ranges(i)[0]
        assert low == pytest.approx(automaton.ranges(i)[0][0])
        assert high == pytest.approx(automaton.ranges(i)[-1][1])


def test_ends_of_joints_may_be_frames(tmp_path) -> None:
    edge = '<frame name="edge" attached_to="door"><pose>0 0.1 0 0 0 0.3</pose></frame><link name="case">'
    framed = CABINET.replace('<link name="case">', edge).replace("<child>door</child>", "<child>edge</child>")
    framed = framed.replace("<parent>case</parent>", "<parent>corner</parent>")
    assert loaded(tmp_path, framed)[0] == loaded(tmp_path, CABINET)[0]


@pytest.mark.filterwarnings("error")
def test_a_link_that_stands_upright_warns_of_nothing(tmp_path) -> None:
    upright = CABINET.replace("0.1 0 0.2 0 0.7 0", "0.1 0 0.2 0.3 1.5707963267948966 0.1")
    automaton, _ = loaded(tmp_path, upright)
    along = Rotation.from_euler("x", 0.3).apply([np.cos(0.2), -np.sin(0.2), 0.0])
    assert_allclose(automaton.modes[0].joints[1].axis, along, atol=1e-9)


def test_older_files_and_joints_that_follow(tmp_path) -> None:
    text = CABINET.replace('<xyz expressed_in="case">0 0.6 0.8</xyz>', "<xyz>0 0 1</xyz>").replace(
        "<limit><lower>0</lower>", "<use_parent_model_frame>true</use_parent_model_frame><limit><lower>0</lower>"
    )
    follower = (
        '<mimic joint="hinge"><multiplier>0.1</multiplier><offset>0.02</offset><reference>0.1</reference></mimic>'
    )
    automaton, _ = loaded(tmp_path, text.replace("<xyz>0 0 2</xyz>", f"<xyz>0 0 2</xyz>{follower}"))
    assert_allclose(automaton.modes[0].joints[0].axis, [0.0, 0.0, 1.0], atol=1e-12)
    (tie,) = automaton.modes[0].ties
    assert (tie.coordinate, tie.weights, tie.offset) == (1, (0.1, 0.0), pytest.approx(0.01))


def test_without_limits_and_joints_to_the_world(tmp_path) -> None:
    endless = CABINET.replace("<limit><lower>0</lower><upper>1.6</upper></limit>", "")
    automaton, _ = loaded(tmp_path, endless)
    assert not any(h.bound and h.bound.coordinate == 0 for h in automaton.modes[0].invariant.half_spaces)
    floating = CABINET.replace(
        '<joint name="stands" type="fixed"><parent>world</parent><child>case</child></joint>', ""
    )
    assert loaded(tmp_path, floating)[0] == loaded(tmp_path, CABINET)[0]
    world = CABINET.replace('<sdf version="1.9">', '<sdf version="1.9"><world name="w">').replace(
        "</sdf>", "</world></sdf>"
    )
    assert loaded(tmp_path, world)[0] == loaded(tmp_path, CABINET)[0]


def test_what_is_left_out_is_reported(tmp_path) -> None:
    plane = CABINET.replace("<sphere><radius>0.02</radius></sphere>", "<plane><normal>0 0 1</normal></plane>")
    loose = plane.replace("</model>", f'<link name="cup">{INERTIAL}</link></model>')
    automaton, notes = loaded(tmp_path, loose)
    assert "link knob: a plane is left out" in notes
    assert "link cup: no joint holds it, it stands where it is" in notes
    assert automaton.n == 2


def but(*changes: tuple[str, str]) -> str:
    text = CABINET
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


SLIDES = "<axis><xyz>0 0 2</xyz><limit><lower>-0.05</lower><upper>0.3</upper></limit></axis>"
REFUSED = {
    "a robot file": ("<robot name='a'/>", "expected <sdf>, found <robot>"),
    "two models": (but(("</sdf>", '<model name="other"/></sdf>')), "expected one <model>, found 2"),
    "no model": ('<sdf version="1.9"/>', "expected one <model>, found none"),
    "a model within": (but(("</model>", "<include><uri>model://a</uri></include></model>")), "a <include> within"),
    "a ball": (but(('type="revolute"', 'type="ball"')), "expected a joint of type revolute, continuous"),
    "an unknown frame": (but(('relative_to="corner"', 'relative_to="edge"')), "is called 'edge'"),
    "an unknown link": (but(("<child>tray</child>", "<child>try</child>")), "a link as child, found 'try'"),
    "a circle": (but(('attached_to="case"', 'attached_to="hinge"')), "relative to each other in a circle"),
    "five numbers": (but(("0 0.01 0 0 0.2 0", "0 0.01 0 0 0.2")), "expected 6 numbers, found '0 0.01 0 0 0.2'"),
    "no number": (but(("<upper>1.6</upper>", "<upper>wide</upper>")), "expected 1 number, found 'wide'"),
    "no axis": (but((SLIDES, "")), "missing <axis> of a prismatic joint"),
    "nothing moves": (but(("revolute", "fixed"), ("prismatic", "fixed")), "expected a joint that moves"),
    "a link twice": (but(('<link name="knob">', '<link name="door">')), "the name 'door' is taken already on line"),
    "a link called world": (but(('"knob"', '"world"')), "the name 'world' is taken already"),
    "limits that cross": (but(("<upper>1.6</upper>", "<upper>-1</upper>")), "expected lower < upper"),
}


@pytest.mark.parametrize("why", REFUSED)
def test_what_is_no_object_is_refused(tmp_path, why) -> None:
    text, says = REFUSED[why]
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, text)
    assert says in str(caught.value)
    assert "object.sdf" in str(caught.value)
    assert caught.value.remedy


def test_the_command_makes_a_model(tmp_path) -> None:
    (tmp_path / "cabinet.sdf").write_text(CABINET)
    kind, _ = convert(tmp_path / "cabinet.sdf", tmp_path / "cabinet.yaml")
    assert kind == "model"
    assert load_model(tmp_path / "cabinet.yaml").coordinate_names == ("hinge", "slides")
