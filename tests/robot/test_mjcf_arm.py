"""Arms in MJCF stand as MuJoCo has them, however the file says it: joints, limits, frames, solids."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest
from extras import module_requires
from robot_examples import described

from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.robot.load_arm import load_arm

pytestmark = module_requires("sim")
import mujoco

GEOM = '<geom type="capsule" fromto="0 0 0 0.1 0.02 0" size="0.02"/>'


def chain(first: str, second: str, compiler: str = 'angle="radian"', rest: str = "", inside: str = "") -> str:
    """An arm of two bodies, whose attributes and joints are given, with the site `grip` at its end."""
    return f"""<mujoco><compiler {compiler}/>{rest}<worldbody><body name="b1" {first}{GEOM}
      <body name="b2" {second}{GEOM}{inside}<site name="grip" pos="0.2 0.01 0.03" quat="0.6 0 0.8 0"/></body></body>
      </worldbody></mujoco>"""


HINGE = '><joint name="j1" axis="0 0 1" range="-1.2 1.3"/>'
LAST = 'pos="0.3 0 0.1"><joint name="j2" axis="0 1 0" range="-0.9 1.1"/>'
CLASSES = """<default><joint range="-0.4 0.5"/><default class="bent"><joint type="slide" axis="1 1 0" pos="0.1 0 0"
  range="0.05 0.6"/><site pos="0.07 0 0"/><geom size="0.05"/></default></default>"""
FORMS = {
    "quaternion": chain('pos="0 0 0.4" quat="0.9 0.1 0.3 0.2"' + HINGE, LAST),
    "axis and angle": chain('pos="0 0 0.4" axisangle="1 2 0.5 0.6"' + HINGE, LAST),
    "Euler angles": chain('pos="0 0 0.4" euler="0.3 -0.5 0.7"' + HINGE, LAST),
    "Euler angles in another order": chain('euler="30 -50 70"' + HINGE, LAST, 'eulerseq="zyx"'),
    "two axes": chain('xyaxes="0 1 0.2 -1 0.1 0"' + HINGE, LAST),
    "one axis": chain('zaxis="0.2 1 0.4"' + HINGE, LAST),
    "degrees": chain('pos="0 0 0.4"><joint name="j1" axis="0 1 1" range="-70 80"/>', LAST, ""),
    "a slide beside degrees": chain('><joint name="j1" type="slide" axis="0 1 0" range="0.1 1.4"/>', LAST, ""),
    "a reference of a hinge": chain('pos="0 0 1"><joint name="j1" axis="0.6 0 0.8" ref="0.5" range="-1 2"/>', LAST),
    "a reference of a slide": chain('><joint name="j1" type="slide" axis="0.6 0 0.8" ref="0.2" range="0 1"/>', LAST),
    "a joint beside the body": chain('pos="0 0 1"><joint name="j1" pos="0.2 0.1 0" axis="0 1 0" range="-1 1"/>', LAST),
    "two joints of one body": chain(
        '><joint name="j1" type="slide" axis="0 0 1" range="0 1"/>'
        '<joint name="j0" pos="0.1 0 0" axis="1 0 0" range="-1 1"/>',
        LAST,
    ),
    "classes": chain('><joint name="j1" class="bent"/>', '><joint name="j2" axis="0 0 1"/>', rest=CLASSES),
    "a class of children": chain(
        'childclass="bent"><joint name="j1"/>', '><joint name="j2" axis="0 1 1"/>', rest=CLASSES
    ),
    "a joint without limits": chain('><joint name="j1" axis="1 0 0"/>', LAST),
    "a frame": chain(
        HINGE,
        LAST,
        inside=f'<frame pos="0.1 0 0.2" euler="0.1 0.2 0.3">{GEOM}<site name="other" pos="0 0 0.1"/></frame>',
    ).replace("grip", "unused").replace('name="other"', 'name="grip"'),
    "sites on bodies without joints": chain(
        HINGE,
        LAST,
        inside='<body pos="0.1 0 0" quat="0.9 0.1 0 0.4"><body pos="0 0.1 0"><site name="deep" pos="0 0.05 0.1"/>'
        '<geom size="0.01"/></body></body>',
    ).replace("grip", "unused").replace('name="deep"', 'name="grip"'),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_an_arm_stands_as_in_mujoco(form: str) -> None:
    text = FORMS[form]
    arm, twin = load_arm(described(text, "grip")), mujoco.MjModel.from_xml_string(text)
    data, site = mujoco.MjData(twin), twin.site("grip").id
    for q in arm.sample(np.random.default_rng(0), 20):
        for name, value in zip(arm.joints, q, strict=True):
            data.qpos[twin.jnt_qposadr[twin.joint(name).id]] = value
        mujoco.mj_kinematics(twin, data)
        pose = arm.matrix(q)
        assert pose[:3, 3] == pytest.approx(data.site_xpos[site], abs=1e-12)
        assert pose[:3, :3] == pytest.approx(data.site_xmat[site].reshape(3, 3), abs=1e-12)
        placements = pin.GeometryData(arm.geometry)
        pin.updateGeometryPlacements(arm.model, arm.data, arm.geometry, placements, q)
        places = np.array([place.translation for place in placements.oMg])
        assert places == pytest.approx(data.geom_xpos, abs=1e-9)
    for name, low, high in zip(arm.joints, arm.lower, arm.upper, strict=True):
        joint = twin.joint(name)
        expected = joint.range if twin.jnt_limited[joint.id] else (-np.inf, np.inf)
        assert (low, high) == pytest.approx(tuple(expected))


def test_solids_have_their_sizes() -> None:
    kinds = {
        "sphere": ("0.03", "Sphere"),
        "box": ("0.1 0.2 0.3", "Box"),
        "cylinder": ("0.05 0.2", "Cylinder"),
        "ellipsoid": ("0.1 0.2 0.3", "Ellipsoid"),
    }
    solids = "".join(f'<geom type="{kind}" size="{size}"/>' for kind, (size, _) in kinds.items())
    arm = load_arm(described(chain(HINGE, LAST, inside=solids), "grip"))
    last = [item for item in arm.geometry.geometryObjects if item.name.startswith("b2_")]
    assert [type(item.geometry).__name__ for item in last[1:]] == [name for _, name in kinds.values()]
    assert last[2].geometry.halfSide == pytest.approx([0.1, 0.2, 0.3])
    assert last[3].geometry.halfLength == pytest.approx(0.2)


def test_what_collides_with_nothing_is_no_solid_and_a_floor_is_one() -> None:
    seen = '<geom size="0.5" contype="0" conaffinity="0"/>'
    floor = '<geom name="floor" type="plane" size="0 0 1" pos="0 0 -0.4"/><body name="b1"'
    arm = load_arm(described(chain(HINGE, LAST, inside=seen).replace('<body name="b1"', floor), "grip"))
    assert sorted(item.name for item in arm.geometry.geometryObjects) == ["b1_0", "b2_0", "world_0"]
    (ground,) = (item for item in arm.geometry.geometryObjects if item.name == "world_0")
    top = ground.placement.translation[2] + ground.geometry.halfSide[2]
    assert top == pytest.approx(-0.4)


def test_a_joint_that_follows_another_does_not_move_the_tool() -> None:
    coupled = chain(HINGE, LAST).replace("</mujoco>", '<equality><joint joint1="j2" joint2="j1"/></equality></mujoco>')
    with pytest.raises(InputError, match="joint 'j2' follows another one"):
        load_arm(described(coupled, "grip"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (chain('><joint name="j1" type="ball"/>', LAST), "joint 'j1' is of kind Spherical"),
        (chain('pos="0 0 0.4" quat="1 0 0"' + HINGE, LAST), "cannot be read as a robot"),
        (chain(HINGE, LAST, inside='<geom type="sdf"/>'), "robot"),
        (chain(HINGE, LAST).replace("grip", "end"), "no frame 'grip'"),
    ],
)
def test_mistakes_are_reported_in_one_line(text: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as refused:
        load_arm(described(text, "grip"))
    assert "\n" not in str(refused.value)


def test_without_mujoco_the_sentence_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match="an arm in MJCF needs MuJoCo: pip install 'mujoco"):
        load_arm(described(FORMS["quaternion"], "grip"))
