"""Steps that MuJoCo takes alone are those that it takes one by one, and nothing that happens in them is missed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from execution_objects import SHUT, arm, door, drawer, worm
from extras import requires
from held_examples import stamp, tool
from test_mujoco_path import on_a_path

from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import PhysicalPlant
from micah_plan.execution.mujoco.held import HeldPlant
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.plant import Command
from micah_plan.execution.pose import command
from micah_plan.robot.along_plan import start_posture
from micah_plan.task.start import Start

pytestmark = requires("sim")

STAPLER = Path(__file__).resolve().parents[2] / "problems" / "stapler_on_books.yaml"


@pytest.fixture(scope="module")
def problem():
    return load_problem(STAPLER)


def with_event_stepping_and_without(run, monkeypatch):
    """What `run` returns either way, and how many steps were taken alone."""
    alone = [0]
    free_steps = PhysicalPlant._free_steps

    def counted(plant, controls):
        alone[0] += len(controls)
        return free_steps(plant, controls)

    def careful(plant, _controls, begin):
        plant._calm = 0
        return begin

    with monkeypatch.context() as patch:
        patch.setattr(PhysicalPlant, "_free_steps", counted)
        leaping = run()
    with monkeypatch.context() as patch:
        patch.setattr(PhysicalPlant, "_step_to_event", careful)
        return leaping, run(), alone[0]


def assert_same(leaping, careful):
    for (measured, truth), (expected, true) in zip(leaping, careful, strict=True):
        np.testing.assert_array_equal(measured.position, expected.position)
        np.testing.assert_array_equal(measured.quaternion, expected.quaternion)
        np.testing.assert_array_equal(truth.x, true.x)
        np.testing.assert_array_equal(truth.latched, true.latched)
        assert (truth.mode, truth.incident) == (true.mode, true.incident)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("automaton", "start", "inputs", "change"),
    [
        # Into the latch, pressed, and out again; then with a hand that is too weak for its damping.
        (door(), Start((1.0,), (0.0,), "swinging"), [0.07] * 4 + [-0.05] * 3 + [0.06] * 3, {}),
        (door(0.5), Start((SHUT,), (0.0,), "shut"), [-0.03, 0.02, -0.08, -0.1], {"latch_capture": 0.02}),
        (drawer(), Start((0.05,), (0.0,)), [0.05] * 6, {"max_force": 12.0}),
        (worm(), Start((0.1,), (0.0,)), [0.3] * 3, {"max_force": 30.0}),
        (arm(), Start((0.1, 0.0), (0.0, 0.0)), [[0.1, -0.04], [0.1, 0.2]], {"gravity": 9.81}),
        (on_a_path(door()), Start((1.0,), (0.0,), "swinging"), [0.07] * 4 + [-0.05] * 3 + [0.06] * 3, {}),
    ],
    ids=["latch", "released", "weak hand", "screw", "chain", "path"],
)
def test_standing_objects(automaton, start, inputs, change, monkeypatch):
    def run():
        plant = StandingPlant(automaton, start, PhysicalParameters(**change))
        plant.reset(np.random.default_rng(1))
        mode, found = automaton.modes[0].name, []
        for u in inputs:
            measured = plant.apply(command(automaton, mode, plant.truth().x, np.atleast_1d(u)))
            found.append((measured, plant.truth()))
        plant.close()
        return found

    leaping, careful, alone = with_event_stepping_and_without(run, monkeypatch)
    assert_same(leaping, careful)
    for (measured, _), (expected, _) in zip(leaping, careful, strict=True):
        np.testing.assert_array_equal(measured.force, expected.force)
    assert alone > 500


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "inputs", "incident"),
    [
        ("pressed", [[0.0, 0.0, -0.015]] * 15 + [[0.0, 0.0, 0.02]] * 3, ""),
        ("into the books", [[0.03, 0.0, -0.01]] * 14, "'book_2' was knocked over"),
        ("against the books", [[0.0, 0.0, -0.06]] + [[0.03, 0.0, 0.0]] * 14, "'book_4' was knocked over"),
        ("against the shelf", [[0.0, 0.0, 0.03]] * 3 + [[0.03, 0.0, 0.0]] * 16, "it hit 'shelf'"),
        ("beside the table", [[-0.05, 0.0, -0.01]] * 8 + [[0.0, 0.0, -0.05]] * 5, ""),
    ],
)
def test_a_held_object_on_slides(name, inputs, incident, problem, monkeypatch):
    def run():
        plant = HeldPlant(replace(problem, robot=None, grasp=None))
        plant.reset(np.random.default_rng(8))
        found = [(plant.apply(Command(np.array(u), None, None)), plant.truth()) for u in inputs]
        plant.close()
        return found

    leaping, careful, alone = with_event_stepping_and_without(run, monkeypatch)
    assert_same(leaping, careful)
    assert incident in leaping[-1][1].incident, name
    assert bool(leaping[-1][1].incident) == bool(incident)
    assert alone > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "inputs", "incident"),
    [
        ((-0.084, 0.0, -0.014), [[0.0, 0.0, -0.03]] * 12, ""),
        ((-0.084, 0.0, -0.014), [[0.03, -0.01, -0.01]] * 12, "'book_"),
        ((-0.084, 0.0, -0.1), [[0.0, 0.0, -0.03]] * 6, "the arm's flange hit 'table'"),
        ((-0.03, 0.0, -0.055), [[0.0, 0.0, 0.0]], "hit 'lower_arm'"),
    ],
    ids=["pressed", "into the books", "the arm on the table", "its finger in the way"],
)
def test_a_held_object_on_an_arm(place, inputs, incident, problem, monkeypatch):
    posture = start_posture(problem)

    def run():
        plant = HeldPlant(replace(problem, grasp=replace(problem.grasp, position=place)), posture=posture)
        plant.reset(np.random.default_rng(3))
        found = [(plant.apply(Command(np.array(u), None, None)), plant.truth()) for u in inputs]
        plant.close()
        return found

    leaping, careful, _ = with_event_stepping_and_without(run, monkeypatch)
    assert_same(leaping, careful)
    assert incident in leaping[-1][1].incident
    assert bool(leaping[-1][1].incident) == bool(incident)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("make", "inputs"), [(stamp, [[0.0, 0.0, -0.01]] * 13), (tool, [[0.06, 0.0]] * 6)], ids=["stamp", "tool"]
)
def test_held_objects_of_other_structure(make, inputs, monkeypatch):
    def run():
        plant = HeldPlant(make())
        plant.reset(np.random.default_rng(2))
        found = [(plant.apply(Command(np.array(u), None, None)), plant.truth()) for u in inputs]
        plant.close()
        return found

    assert_same(*with_event_stepping_and_without(run, monkeypatch)[:2])


def test_a_touch_that_is_too_deep_is_noticed_though_the_body_may_be_touched():
    plant = HeldPlant(replace(tool(), start=Start((-0.2, 0.0), (0.0, 0.0))))
    plant.reset(np.random.default_rng(2))
    plant.apply(Command(np.zeros(2), None, None))
    assert "it hit 'table' at " in plant.truth().incident
    plant.close()


def test_physics_that_diverge_while_the_engine_is_alone_are_reported(problem):
    stiff = replace(problem, robot=None, grasp=None, plant={"pivot_stiffness": 1e9})
    plant = HeldPlant(stiff)
    plant.reset(np.random.default_rng(0))
    with pytest.raises(InputError, match="became unstable"):
        plant.apply(Command(np.array([0.01, 0.0, 0.0]), None, None))
    plant.close()


def test_a_warning_of_the_engine_ends_a_leap_but_loses_no_step():
    """MuJoCo stops a roll-out at any warning, for example of a control that is no number, which it takes for 0."""
    from micah_plan.mujoco_library import import_mujoco

    mujoco = import_mujoco()
    text = """<mujoco><worldbody><body><joint name="j" type="slide"/><geom size="0.1"/></body></worldbody>
    <actuator><motor joint="j"/></actuator><sensor><jointpos joint="j"/></sensor></mujoco>"""
    plant = PhysicalPlant(door(), PhysicalParameters(), mujoco.MjModel.from_xml_string(text))
    controls = np.ones((200, 1))
    controls[70] = np.nan
    taken = []
    while sum(taken) < len(controls):
        taken.append(len(plant._free_steps(controls[sum(taken) :])))
    assert len(taken) > 1
    assert plant.data.time == pytest.approx(0.2)
