"""Models as SDF: Drake has the parts where the model has them, with its masses and limits."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from micah_plan.automaton.joint import screw
from micah_plan.automaton.kinematics import part_poses
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError
from micah_plan.exchange.bodies import inertia_of
from micah_plan.exchange.convert import convert
from micah_plan.exchange.sdf import sdf_text

ROOT = Path(__file__).resolve().parents[2]
MODELS = ["microwave", "drawer", "cabinet", "slot"]


@pytest.mark.parametrize("name", MODELS)
def test_drake_has_the_parts_where_the_model_has_them(name: str) -> None:
    plant_of = pytest.importorskip("pydrake.multibody.plant", reason="Drake reads SDF: pip install drake")
    from pydrake.multibody.parsing import Parser

    automaton = load_model(ROOT / "models" / f"{name}.yaml")
    plant = plant_of.MultibodyPlant(0.001)
    Parser(plant).AddModelsFromString(sdf_text(automaton, "object", 700.0), "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.num_positions() == automaton.n
    moving = max(automaton.modes, key=lambda mode: int(mode.driven.sum()))
    for state in np.random.default_rng(0).uniform(0.0, 0.3, (5, automaton.n)):
        for i, coordinate in enumerate(automaton.coordinates):
            children = {link.child for link in automaton.links}
            joint = plant.GetJointByName(f"{coordinate.name}_joint" if coordinate.name in children else coordinate.name)
            plant.SetPositions(context, _with(plant.GetPositions(context), joint.position_start(), state[i]))
            ranges = automaton.ranges(i)
            assert joint.position_lower_limits()[0] == pytest.approx(ranges[0][0])
            assert joint.position_upper_limits()[0] == pytest.approx(ranges[-1][1])
        for part, pose in part_poses(automaton, moving, state).items():
            body = plant.GetBodyByName(part)
            there = plant.EvalBodyPoseInWorld(context, body)
            np.testing.assert_allclose(there.GetAsMatrix4(), pose.as_matrix(), atol=1e-5)
            assert body.default_mass() == pytest.approx(inertia_of(automaton.part(part), 700.0).mass)


def _with(positions: np.ndarray, i: int, value: float) -> np.ndarray:
    changed = positions.copy()
    changed[i] = value
    return changed


def test_the_command_says_what_is_left_out(tmp_path: Path) -> None:
    kind, notes = convert(ROOT / "models" / "microwave.yaml", tmp_path / "door.sdf")
    assert kind == "model"
    assert notes[0] == "left out: 2 modes with guards, noise, probabilities of what was learned, handles"
    root = ElementTree.fromstring((tmp_path / "door.sdf").read_bytes())  # noqa: S314 - our own
    assert [link.attrib["name"] for link in root.iter("link")] == ["base", "door"]
    assert [joint.attrib["type"] for joint in root.iter("joint")] == ["fixed", "revolute"]


def test_a_screw_is_refused() -> None:
    from dataclasses import replace

    drawer = load_model(ROOT / "models" / "drawer.yaml")
    nut = screw((0, 0, 1), (0, 0, 0), 0.01, (0.1, 0, 0))
    turned = replace(drawer, modes=tuple(replace(mode, joints=(nut,)) for mode in drawer.modes))
    with pytest.raises(InputError, match="moves on a screw"):
        sdf_text(turned, "nut")
