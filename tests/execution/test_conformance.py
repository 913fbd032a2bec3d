"""The check of plants: those that come with the package pass, and every way to be wrong is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from execution_objects import SHUT, arm, door, drawer
from extras import requires

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.conformance import check_plant
from micah_plan.execution.nominal import NominalPlant
from micah_plan.task.goal import Goal
from micah_plan.task.plants import BUILT_IN
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

PULL = Problem(drawer(), Start((0.02,), (0.01,)), Goal(((0, 0.25, 0.008),)))
CLOSE = Problem(door(0.3), Start((0.2,), (0.02,)), Goal(((0, SHUT, 0.03),), ("shut",)))
CHAIN = Problem(arm(), Start((0.1, 0.02), (0.01, 0.003)), Goal(((0, 0.5, 0.1),)))
KINDS = [pytest.param(kind, marks=requires("sim")) if kind == "mujoco" else kind for kind in BUILT_IN]


def faults(plant, problem) -> list[str]:
    with pytest.raises(InputError) as caught:
        check_plant(plant, problem)
    return [str(error) for error in caught.value.each()]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("problem", [PULL, CLOSE, CHAIN], ids=["drawer", "door", "chain"])
def test_the_plants_of_the_package_pass_and_every_input_is_tried(problem, kind):
    for seed in range(3):
        assert check_plant(make_plant(problem, kind), problem, seed) == ()


@pytest.mark.sweep
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["microwave_close", "drawer_behind_door", "stapler_on_books"])
def test_they_pass_on_shipped_problems(repository, name, kind):
    problem = load_problem(repository / "problems" / f"{name}.yaml")
    plant = make_plant(problem, kind)
    untried = check_plant(plant, problem)
    plant.close()
    assert len(untried) == (2 if name == "drawer_behind_door" else 0)  # both parts are held at its start


@pytest.mark.parametrize("effect", [("gain", "gain", 0.6), ("delay", "steps", 2.0), ("sensor_scale", "scale", 0.7)])
def test_what_the_model_knows_of_the_machine_is_no_fault(effect):
    name, parameter, value = effect
    known = replace(PULL, automaton=with_effect(drawer(), Effect(name, "drawer", ((parameter, value),))))
    assert check_plant(make_plant(known, "nominal"), known) == ()
    if name == "gain":
        assert "commanded to move drawer by" in faults(weak(PULL), PULL)[0]


def weak(problem):
    """Nine tenths of every command are lost."""
    lossy = with_effect(problem.automaton, Effect("gain", "drawer", (("gain", 0.1),)))
    return NominalPlant(lossy, problem.start)


class Wrong(NominalPlant):
    """Mistaken in one respect."""

    def reset(self, rng):
        return self.changed(super().reset(rng))

    def apply(self, command):
        return self.changed(super().apply(self.taken(command)))

    def changed(self, seen):
        return seen

    def taken(self, command):
        return command


class Millimetres(Wrong):
    def changed(self, seen):
        return replace(seen, position=1000.0 * seen.position)


class ScalarFirst(Wrong):
    def changed(self, seen):
        return replace(seen, quaternion=np.roll(seen.quaternion, 1, axis=1))


class CameraFrame(Wrong):
    def changed(self, seen):
        return replace(seen, position=seen.position + np.array([0.0, 0.4, 0.0]))


class Backwards(Wrong):
    def taken(self, command):
        return replace(command, input=-command.input)


class Deaf(Wrong):
    def taken(self, command):
        return replace(command, input=0.0 * command.input)


class Drifting(Wrong):
    def taken(self, command):
        return replace(command, input=command.input + 0.06)


class WallClock(Wrong):
    def changed(self, seen):
        return replace(seen, time=1.7e9 + seen.time)


class Unrepeatable(Wrong):
    chances = np.random.default_rng(0)

    def reset(self, rng):
        del rng
        return super().reset(self.chances)


class Elsewhere(Wrong):
    def truth(self):
        true = super().truth()
        return replace(true, position=true.position + 0.3)


class ShortTruth(Wrong):
    def truth(self):
        return replace(super().truth(), latched=np.zeros(3, dtype=bool))


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (Millimetres, "m from where its joint allows it to be; give the position of the part's origin in m"),
        (CameraFrame, "in the base frame of the model"),
        (ScalarFirst, "the quaternion has its scalar first; give it last"),
        (Backwards, "commanded to move"),
        (Deaf, "commanded to move"),
        (Drifting, "without a command drawer moved by"),
        (WallClock, "time must count from the reset"),
        (Unrepeatable, "must start alike for the same seed"),
        (Elsewhere, "m from its true place"),
        (ShortTruth, "Truth.latched must have shape (1,). Got (3,)"),
    ],
)
def test_each_way_to_be_wrong_is_named(kind, said):
    found = faults(kind.of(PULL), PULL)
    assert any(sentence.startswith(f"{kind.__name__}: ") and said in sentence for sentence in found), found


def test_a_part_that_is_not_always_seen_is_no_fault_and_its_count_is_reported():
    class Hidden(NominalPlant):
        answers = 0

        def apply(self, command):
            seen, self.answers = super().apply(command), self.answers + 1
            return replace(seen, position=np.full((1, 3), np.nan)) if self.answers in self.hidden else seen

        hidden = (1,)

    (sentence,) = check_plant(Hidden.of(PULL), PULL)
    assert sentence.startswith("part 'drawer' was not seen after 1 of ")

    class AndDeaf(Hidden, Deaf):
        """Nor does it move, which the first answer shows."""

        hidden = (2,)

    assert any("commanded to move" in sentence for sentence in faults(AndDeaf.of(PULL), PULL))


def test_a_start_elsewhere_is_named():
    elsewhere = replace(PULL, start=replace(PULL.start, mean=(0.2,)))
    (sentence,) = faults(NominalPlant.of(elsewhere), PULL)
    assert "after a reset, but the problem starts at 20 ± 10 mm" in sentence


def test_answers_that_are_none_and_missing_methods_are_named():
    class Half:
        def reset(self, rng): ...

    with pytest.raises(InputError, match=r"Half is no plant: it has no apply\(\), close\(\)"):
        check_plant(Half(), PULL)

    class Silent(NominalPlant):
        def reset(self, rng):
            del rng

    with pytest.raises(InputError, match="must answer with a Measurement"):
        check_plant(Silent.of(PULL), PULL)
