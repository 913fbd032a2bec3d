"""A recording that says what its commands mean: places are gone after in roll-outs, and nothing is compared."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest
from test_meaning import servo_run

from micah_plan import solve
from micah_plan.api.calibration import calibrate as calibrated
from micah_plan.api.prediction import predict
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.commanded_places import as_commanded, without_superseded
from micah_plan.automaton.effects.memories import AS_COMMANDED, is_as_commanded
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.input_memory import with_memory_states
from micah_plan.errors import InputError
from micah_plan.recording.commands import with_commands
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording


def rollout_rms(automaton, recording) -> float:
    return float(np.sqrt(np.mean(predict_recording(automaton, recording)[0].rollout.configuration ** 2)))


@pytest.fixture(scope="module")
def obedient():
    """A machine that is at the commanded place after each step, seen with noise."""
    return plants.door_recording([servo_run(200, 3, share=1.0)])


def test_roll_outs_follow_stated_places(door, obedient) -> None:
    assert rollout_rms(door, with_commands(obedient, "position")) < 0.004
    assert rollout_rms(door, with_commands(obedient, "displacement")) > 0.01
    assert predict(door, obedient, commands="position").json()["rollout"]["rotation_rmse_rad"] < 0.01


def test_a_machine_at_its_places_lacks_nothing_and_the_model_keeps_the_stated_meaning(door, obedient) -> None:
    found = calibrate(door, with_commands(obedient, "position"))
    assert found.verdict == "none"
    assert [is_as_commanded(effect) for effect in found.automaton.effects] == [True]
    assert rollout_rms(found.automaton, obedient) < 0.004


def test_a_servo_stated_to_follow_places_is_fitted(door) -> None:
    recording = plants.door_recording([servo_run(300, 1, share=0.3)])
    found = calibrated(door, recording, commands="position").calibration
    (effect,) = found.effects
    assert effect.effect.name == "follow"
    assert dict(effect.effect.parameters)["share"] == pytest.approx(0.3, rel=0.1)
    assert [effect.name for effect in found.automaton.effects] == ["follow"], "what was said is superseded"
    assert found.after.rollout < 0.3 * found.before.rollout


def test_stated_displacements_are_never_places(door) -> None:
    recording = with_commands(plants.door_recording([servo_run(150, 1, share=0.3)]), "displacement")
    assert "follow" not in [effect.effect.name for effect in calibrate(door, recording).effects]


def test_a_model_that_follows_places_refuses_displacements(door, obedient) -> None:
    follows = with_effect(door, Effect("follow", "door", (("share", 0.4), *AS_COMMANDED[1:])))
    said = with_commands(obedient, "displacement")
    with pytest.raises(InputError, match="commands are displacements, but in the model door follows places"):
        predict_recording(follows, said)
    assert as_commanded(follows, with_commands(obedient, "position")) is follows
    told = with_effect(door, Effect("follow", "door", AS_COMMANDED))
    assert as_commanded(told, said).effects == ()
    assert without_superseded(with_effect(told, follows.effects[0])).effects == follows.effects


def test_plans_are_those_without_it(repository) -> None:
    """That commands are places changes no step of the model, so it costs no state."""
    from micah_plan.documents.problem import load_problem

    problem = load_problem(repository / "problems" / "drawer_open.yaml")
    (name,) = (coordinate.name for coordinate in problem.automaton.coordinates)
    told = with_effect(problem.automaton, Effect("follow", name, AS_COMMANDED))
    assert with_memory_states(told) is told
    first, second = solve(problem), solve(problem, model=told)
    assert second.outcome == first.outcome == "solved"
    np.testing.assert_array_equal(second.plan.trajectory.inputs, first.plan.trajectory.inputs)
