"""The models that the project ships are what it learns from the demonstrations that it ships."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan import workflow
from micah_plan.spec.model_file import load_model
from micah_plan.spec.parts_file import load_parts

OBJECTS = ("microwave", "drawer")


def thresholds(automaton):
    return np.array([half_space.c for edge in automaton.edges for half_space in edge.guard.half_spaces])


@pytest.mark.parametrize("name", OBJECTS)
def test_a_shipped_model_is_learned_from_the_shipped_demonstration(repository, name):
    shipped = load_model(repository / "models" / f"{name}.yaml")
    recording = workflow.read(repository / "examples" / "demonstrations" / f"{name}.csv")
    learned = workflow.learn(recording, parts=load_parts(repository / "models" / "parts" / f"{name}.yaml")).automaton
    assert shipped.provenance["recording"] == recording.digest()
    assert learned.parts == shipped.parts
    assert [mode.name for mode in learned.modes] == [mode.name for mode in shipped.modes]
    assert [edge.name for edge in learned.edges] == [edge.name for edge in shipped.edges]
    # Not to the last bit: another machine's linear algebra rounds differently.
    assert thresholds(learned) == pytest.approx(thresholds(shipped), abs=1e-4)
    for ours, theirs in zip(learned.modes, shipped.modes, strict=True):
        for joint, expected in zip(ours.joints, theirs.joints, strict=True):
            assert joint.kind == expected.kind
            assert joint.position == pytest.approx(expected.position, abs=1e-4)
            assert joint.axis == pytest.approx(expected.axis, abs=1e-4)


def test_the_learned_door_is_the_true_door(repository):
    """Against the true mechanism of the simulation: hinge, radius and where it shuts."""
    door = load_model(repository / "models" / "microwave.yaml").mode("revolute").joints[0]
    assert np.dot(door.axis, (0.0, 0.0, -1.0)) > np.cos(0.01)
    assert np.array(door.center)[:2] == pytest.approx((-0.24, 0.01), abs=0.003)
    (shut,) = [edge.guard.half_spaces[0].c for edge in load_model(repository / "models" / "microwave.yaml").edges
               if edge.name == "revolute -> rigid"]  # fmt: skip
    assert shut == pytest.approx(1.2, abs=0.01)


def test_the_learned_drawer_is_the_true_drawer(repository):
    drawer = load_model(repository / "models" / "drawer.yaml").mode("prismatic").joints[0]
    assert np.dot(drawer.axis, (0.0, 1.0, 0.0)) > np.cos(0.01)
