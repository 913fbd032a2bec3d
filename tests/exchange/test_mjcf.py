"""Models as MJCF: MuJoCo has the parts where the model has them, moves them, and stops them at their limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import module_requires
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.automaton.joint import screw
from micah_plan.automaton.kinematics import part_poses
from micah_plan.documents.model import load_model
from micah_plan.exchange.bodies import inertia_of
from micah_plan.exchange.convert import convert
from micah_plan.exchange.mjcf import mjcf_text

pytestmark = module_requires("sim")
import mujoco

ROOT = Path(__file__).resolve().parents[2]
MODELS = ["microwave", "drawer", "cabinet", "slot", "light_dark"]


def loaded(automaton: HybridAutomaton, density: float = 500.0) -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_string(mjcf_text(automaton, "object", density))
    return model, mujoco.MjData(model)


def joint_of(automaton: HybridAutomaton, coordinate: str) -> str:
    return f"{coordinate}_joint" if coordinate in {link.child for link in automaton.links} else coordinate


@pytest.mark.parametrize("name", MODELS)
def test_parts_are_where_the_model_has_them(name: str) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    model, data = loaded(automaton)
    moving = max(automaton.modes, key=lambda mode: int(mode.driven.sum()))
    for state in np.random.default_rng(0).uniform(0.0, 1.0, (5, automaton.n)):
        for c, value in zip(automaton.coordinates, state, strict=True):
            data.qpos[model.joint(joint_of(automaton, c.name)).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        for part, pose in part_poses(automaton, moving, state).items():
            body = data.body(part)
            np.testing.assert_allclose(body.xpos, pose.translation, atol=1e-9)
            turned = Rotation.from_matrix(body.xmat.reshape(3, 3)) * pose.rotation.inv()
            assert turned.magnitude() < 1e-9


@pytest.mark.parametrize("name", MODELS)
def test_motors_move_the_parts_and_limits_stop_them(name: str) -> None:
    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    model, data = loaded(automaton)
    assert model.nu == automaton.n
    for c in automaton.coordinates:
        low, high = automaton.ranges(automaton.index(c.name))[0][0], automaton.ranges(automaton.index(c.name))[-1][1]
        joint = model.joint(joint_of(automaton, c.name))
        mujoco.mj_resetData(model, data)
        data.ctrl[model.actuator(joint.name).id] = 3.0
        start = float(data.qpos[joint.qposadr[0]])
        for _ in range(6000):
            mujoco.mj_step(model, data)
        assert np.isfinite(data.qpos).all()
        reached = float(data.qpos[joint.qposadr[0]])
        assert reached > start + 0.05
        if np.isfinite(low + high):
            assert reached == pytest.approx(high, abs=0.05 * (high - low))


def test_a_screw_goes_along_while_it_turns() -> None:
    drawer = load_model(ROOT / "models" / "drawer.yaml")
    joint = screw((0, 0, 1), (0.1, 0, 0), 0.05, (0.2, 0.0, 0.3))
    modes = tuple(replace(mode, joints=(joint,)) for mode in drawer.modes if mode.driven.any())
    turning = replace(drawer, modes=modes, edges=(), learned=())
    model, data = loaded(turning)
    data.ctrl[0] = 0.02
    for _ in range(3000):
        mujoco.mj_step(model, data)
    angle = float(data.joint("drawer_joint").qpos[0])
    assert abs(angle) > 0.05
    pose = part_poses(turning, turning.modes[0], np.array([angle]))["drawer"]
    np.testing.assert_allclose(data.body("drawer").xpos, pose.translation, atol=2e-3)


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
def test_masses_and_moments_are_those_that_mujoco_computes(kind: str) -> None:
    sizes = {"box": (0.3, 0.2, 0.1), "cylinder": (0.05, 0.4), "sphere": (0.1,)}
    turned = tuple(Rotation.from_euler("xyz", [0.3, -0.8, 1.1]).as_quat().tolist())
    part = load_model(ROOT / "models" / "drawer.yaml").part("drawer")
    shape = Primitive(kind, sizes[kind], (0.1, -0.2, 0.3), turned)
    own = inertia_of(replace(part, shapes=(shape, Primitive("box", (0.1, 0.1, 0.1), (0.5, 0.0, 0.0)))), 700.0)
    size = np.array(sizes[kind]) / [{"box": 2}.get(kind, 1)] if kind != "cylinder" else np.array([0.05, 0.2])
    quat = np.array(turned)[[3, 0, 1, 2]]
    text = (
        f"<mujoco><worldbody><body><freejoint/><geom type='{kind}' size='{' '.join(map(str, size))}' "
        f"pos='0.1 -0.2 0.3' quat='{' '.join(map(str, quat))}' density='700'/>"
        "<geom type='box' size='0.05 0.05 0.05' pos='0.5 0 0' density='700'/></body></worldbody></mujoco>"
    )
    model = mujoco.MjModel.from_xml_string(text)
    assert own.mass == pytest.approx(model.body_mass[1])
    np.testing.assert_allclose(own.center, model.body_ipos[1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.eigvalsh(own.moments), np.sort(model.body_inertia[1]), rtol=1e-9)


def test_what_is_left_out_is_reported(tmp_path: Path) -> None:
    kind, notes = convert(ROOT / "models" / "microwave.yaml", tmp_path / "m.xml")
    assert kind == "model"
    assert notes[0] == "left out: 2 modes with guards, noise, probabilities of what was learned"
    assert "500 kg/m^3" in notes[1]
    _, of_urdf = convert(ROOT / "models" / "microwave.yaml", tmp_path / "m.urdf")
    assert of_urdf[0].endswith("handles")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml")).site("door_handle")
    mujoco.MjModel.from_xml_path(str(tmp_path / "m.urdf"))  # MuJoCo reads URDF too
