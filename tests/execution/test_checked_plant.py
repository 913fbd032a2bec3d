"""What an execution takes from plants: measurements are checked, failures told, logs kept, plants closed."""

from __future__ import annotations

import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from execution_objects import drawer, pulling

from micah_plan.belief.filter import predict_belief, update
from micah_plan.errors import InputError
from micah_plan.execution.checked_plant import CheckedPlant, checked_measurement, make_plant
from micah_plan.execution.closed_loop import Episode, execute_episode
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Measurement, Plant, PlantError, Referee
from micah_plan.execution.trials import run_trials
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.plants import BUILT_IN
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

PULL = Problem(drawer(), Start((0.02,), (0.01,)), Goal(((0, 0.25, 0.008),)))
PLAN = Plan("solved", "", pulling())
STEPS = 8
SEEN = Measurement(0.5, np.zeros((2, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
PARTS = ("door", "drawer")


class Blind:
    """The drawer as a machine that knows no truth; `before` is called before every step."""

    def __init__(self, problem: Problem) -> None:
        self._plant = NominalPlant.of(problem)
        self.closed, self.step = 0, 0

    def reset(self, rng):
        self.step = 0
        return self._plant.reset(rng)

    def apply(self, command):
        self.step += 1
        self.before()
        return self._plant.apply(command)

    def before(self):
        """Nothing goes wrong."""

    def close(self):
        self.closed += 1


class Slow(Blind):
    """Takes a quarter of a second for a step, and catches what its driver raises."""

    patience: float | None = 0.05

    def before(self):
        for _ in range(2 if self.step == 3 else 0):
            with suppress(Exception):
                time.sleep(0.25)


class SlowToReset(Blind):
    patience = 0.05

    def reset(self, rng):
        time.sleep(2.0)
        return super().reset(rng)


class Patient(Slow):
    patience = None


class Slips(Blind):
    def before(self):
        if self.step == 3:
            raise PlantError("the gripper lost the handle")


class Broken(Blind):
    def before(self):
        if self.step == 3:
            raise ValueError("no such register")


class Interrupted(Blind):
    def before(self):
        if self.step == 3:
            raise KeyboardInterrupt


class ResetOnce(Blind):
    resets = 0

    def reset(self, rng):
        self.resets += 1
        if self.resets == 2:
            raise PlantError("the protective stop is pressed")
        return super().reset(rng)


def trials(kind, **options):
    """(what came of two trials, the plant, the logs that were kept)."""
    made, kept = [], []

    def maker(problem):
        made.append(kind(problem))
        return made[-1]

    try:
        found = run_trials(PULL, PLAN, plant=maker, trials=2, keep=kept.append, **options)
    except BaseException as error:
        found = error
    (plant,) = made
    return found, plant, kept


def test_a_usable_measurement_comes_through_as_it_is_in_arrays_of_its_own():
    given = replace(SEEN, force=np.ones((2, 3)), joints=np.arange(4.0), unseen=np.array([True, False]))
    taken = checked_measurement(given, PARTS)
    for name in ("position", "quaternion", "force", "joints", "unseen"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(given, name))
    given.position[:] = 7.0  # as a driver does that fills the same array again
    assert not taken.position.any()
    nearly = replace(SEEN, quaternion=1.009 * SEEN.quaternion)
    assert checked_measurement(nearly, PARTS).quaternion[0, 3] == 1.009


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time": "now"}, "Measurement.time must be numbers of shape (). Got 'now'"),
        ({"time": np.nan}, "Measurement.time must be finite"),
        ({"time": 0.2}, "Measurement.time must be later at every step. Got 0.2 s after 0.2 s"),
        ({"position": np.zeros((3, 2))}, "Measurement.position must have shape (2, 3). Got (3, 2)"),
        ({"position": np.zeros(3)}, "give one row per part, in the order of the automaton's links"),
        ({"position": np.full((2, 3), 1e7)}, "Measurement.position must be finite and at most 1e+06. Got 1e+07"),
        ({"position": [[0.0, 0.0, 0.0], [0.0]]}, "Measurement.position must be numbers of shape (2, 3)"),
        ({"quaternion": np.zeros((2, 4))}, "Got the norm 0 for part 'door'; give the measured orientation, scalar"),
        ({"quaternion": np.ones((2, 4))}, "must hold unit quaternions. Got the norm 2"),
        ({"quaternion": np.full((2, 4), np.nan)}, "Measurement.quaternion must be finite and at most 1e+06. Got nan"),
        ({"quaternion": np.zeros((2, 3))}, "Measurement.quaternion must have shape (2, 4). Got (2, 3)"),
        ({"quaternion": None}, "Measurement.quaternion must"),
        ({"force": np.zeros((1, 3))}, "Measurement.force must have shape (2, 3). Got (1, 3)"),
        ({"joints": np.zeros((1, 3))}, "Measurement.joints must have shape (J,). Got (1, 3)"),
        ({"joints": [0.0, np.inf]}, "wait for a measurement, or raise PlantError if there is none"),
        ({"unseen": [True]}, "Measurement.unseen must be 2 truth values. Got [True]; leave it out, and answer NaN"),
        ({"unseen": np.ones(2)}, "Measurement.unseen must be 2 truth values"),
    ],
)
def test_what_is_no_measurement_is_one_line_with_the_expected_content(change, said):
    with pytest.raises(InputError) as caught:
        checked_measurement(replace(SEEN, **change), PARTS, after=0.2)
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_no_measurement_at_all_is_named():
    with pytest.raises(InputError, match="a plant must answer with a Measurement. Got tuple"):  # noqa: RUF043
        checked_measurement((0.0, np.zeros((2, 3))), PARTS)


def test_simulations_are_referees_and_machines_need_not_be():
    assert isinstance(NominalPlant.of(PULL), Plant)
    assert isinstance(NominalPlant.of(PULL), Referee)
    assert isinstance(Blind(PULL), Plant)
    assert not isinstance(Blind(PULL), Referee)


def test_without_a_referee_the_belief_judges_the_end():
    found, plant, kept = trials(Blind)
    scored = run_trials(PULL, PLAN, trials=2)
    assert (found.believed, scored.believed) == (True, False)
    assert found.successes == 2
    for blind, seeing in zip(found.results, scored.results, strict=True):
        belief = blind.beliefs[-1]
        assert blind.final_error == PULL.goal.error(belief.means[belief.most_likely])
        assert blind.final_error != seeing.final_error
        assert blind.confidence == seeing.confidence
        assert blind.final_mode == "sliding"
        np.testing.assert_array_equal(blind.recording.action, seeing.recording.action)
        assert seeing.recording.extra.keys() - blind.recording.extra.keys() == {"true_drawer"}
    assert [log.runs for log in kept] == [(0,), (1,)]
    assert plant.closed == 1


def test_a_believed_miss_is_marked_as_believed():
    found, _, _ = trials(Blind, max_steps=3)
    (_, reason), _ = found.failures
    assert "the 3 allowed steps ended with 0 % probability of the goal, but drawer is believed " in reason


def test_a_machine_that_fails_ends_the_trial_with_its_sentence_and_its_log():
    found, plant, kept = trials(Slips)
    assert found.successes == 0
    assert [reason for _, reason in found.failures] == ["the machine failed in step 3: the gripper lost the handle"] * 2
    for result, log in zip(found.results, kept, strict=True):
        assert result.steps == 2
        assert len(result.recording) == len(log) == 3
        assert not np.isnan(log.action).any()  # the last command is what it failed at
    assert plant.closed == 1


def test_a_simulated_failure_keeps_the_last_truth():
    class Stalls(NominalPlant):
        def apply(self, command):
            raise PlantError(f"stalled at {command.input}")

    result = execute_episode(Episode(PULL, pulling()), Stalls.of(PULL), np.random.default_rng(0))
    assert not result.believed
    assert not result.success
    assert result.final_error == pytest.approx(0.23, abs=0.05)


def test_a_machine_that_cannot_be_reset_ends_the_execution_and_keeps_the_log():
    found, plant, kept = trials(ResetOnce)
    assert isinstance(found, PlantError)
    assert str(found) == "the protective stop is pressed"
    assert [log.runs for log in kept] == [(0,)]
    assert plant.closed == 1


def test_an_error_in_the_code_of_a_plant_names_its_line_and_keeps_the_log():
    found, plant, kept = trials(Broken)
    assert isinstance(found, InputError)
    assert found.source == __file__
    assert found.problem == "Broken.apply raised ValueError: no such register"
    assert isinstance(found.__cause__, ValueError)
    line = int(found.where.removeprefix("line "))
    with open(__file__) as file:
        assert "no such register" in file.readlines()[line - 1]
    assert [len(log) for log in kept] == [3]
    assert plant.closed == 1


def test_ctrl_c_keeps_the_log_and_closes_the_plant():
    found, plant, kept = trials(Interrupted)
    assert isinstance(found, KeyboardInterrupt)
    assert [len(log) for log in kept] == [3]
    assert plant.closed == 1


def test_an_error_while_closing_hides_no_other_and_is_reported_if_it_is_the_only_one():
    class Stuck(Slips):
        def close(self):
            super().close()
            raise OSError("the port is gone")

    class BrokenAndStuck(Broken, Stuck):
        """Both."""

    found, _, kept = trials(Stuck)
    assert isinstance(found, InputError)
    assert "Stuck.close raised OSError: the port is gone" in str(found)
    assert len(kept) == 2
    found, plant, _ = trials(BrokenAndStuck)
    assert "apply raised ValueError" in str(found)
    assert plant.closed == 1


def test_a_plant_that_was_handed_over_stays_open():
    plant = Blind(PULL)
    assert run_trials(PULL, PLAN, plant=plant).believed
    assert plant.closed == 0


def test_a_bug_of_the_package_stays_a_bug(monkeypatch):
    def mistaken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(NominalPlant, "_measure", mistaken)
    with pytest.raises(ZeroDivisionError):
        run_trials(PULL, PLAN)


def test_plants_are_made_by_name_or_by_what_makes_them():
    assert isinstance(make_plant(PULL, "nominal"), NominalPlant)
    assert isinstance(make_plant(PULL, Blind), Blind)
    with pytest.raises(InputError, match=f"unknown plant 'clay'; choose {' or '.join(BUILT_IN)}"):
        make_plant(PULL, "clay")
    with pytest.raises(InputError, match=r"Nothing is no plant: it has no reset\(\), apply\(\), close\(\)"):
        make_plant(PULL, type("Nothing", (), {}))
    with pytest.raises(InputError, match=r"NoneType is no plant"):
        make_plant(PULL, lambda _: None)
    with pytest.raises(InputError, match=r"Picky\(problem\) raised TypeError: "):
        make_plant(PULL, type("Picky", (Blind,), {"__init__": object.__init__}))


def test_a_constructor_that_fails_is_one_line_and_one_that_gives_the_reason_is_left_alone():
    def unplugged(_):
        raise OSError("no device /dev/ttyUSB0")

    def stopped(_):
        raise PlantError("the controller is off")

    with pytest.raises(InputError, match=r"unplugged\(problem\) raised OSError: no device /dev/ttyUSB0"):
        make_plant(PULL, unplugged)
    with pytest.raises(PlantError, match=r"^the controller is off$"):
        make_plant(PULL, stopped)


def test_a_plant_may_leave_the_program_without_taking_the_log_with_it():
    class Exits(Blind):
        def before(self):
            sys.exit(3)

    found, plant, kept = trials(Exits)
    assert "Exits.apply raised SystemExit: 3" in str(found)
    assert [len(log) for log in kept] == [1]
    assert plant.closed == 1


def test_many_episodes_share_the_calls_to_filter_and_plants():
    """In lockstep, as a batched filter would serve them, each goes as it goes alone."""
    alone = run_trials(PULL, PLAN, trials=4, seed=2)
    rngs = [np.random.default_rng(np.random.SeedSequence(2, spawn_key=(trial,))) for trial in range(4)]
    problem = replace(PULL, start=replace(PULL.start, mode="sliding"))
    episodes = [Episode(problem, pulling(), run=trial) for trial in range(4)]
    plants = [CheckedPlant(NominalPlant.of(problem), ["drawer"]) for _ in episodes]
    seen = [plant.reset(rng) for plant, rng in zip(plants, rngs, strict=True)]
    beliefs = [episode.prior for episode in episodes]
    running = list(range(4))
    while running:
        readings = {i: episodes[i].observed(beliefs[i], seen[i]) for i in running}
        beliefs = [update(drawer(), b, readings[i]) if i in readings else b for i, b in enumerate(beliefs)]
        orders = {i: episodes[i].decide(beliefs[i], seen[i], plants[i].truth()) for i in running}
        running = [i for i in running if orders[i] is not None]
        for i in running:
            seen[i] = plants[i].apply(orders[i])
        beliefs = [predict_belief(drawer(), b, orders[i].input) if i in running else b for i, b in enumerate(beliefs)]
    together = [episode.result() for episode in episodes]
    assert [one.recording.digest() for one in together] == [one.recording.digest() for one in alone.results]
    assert [one.reason for one in together] == [one.reason for one in alone.results]


@pytest.mark.parametrize("name", ["input", "origin", "handle"])
def test_what_a_plant_does_to_its_command_changes_nothing_but_its_own(name):
    class Scales(Blind):
        def apply(self, command):
            measured = super().apply(command)
            values = getattr(command, name)
            values *= 1000.0  # to millimetres, in place
            return measured

    scaled, plain = (trials(kind)[0].recording for kind in (Scales, Blind))
    for column in ("position", "action"):
        np.testing.assert_array_equal(getattr(scaled, column), getattr(plain, column))
    assert scaled.extra == plain.extra


def test_a_machine_that_does_not_answer_is_given_up() -> None:
    machines = []

    def made(problem):
        machines.append(Slow(problem))
        return machines[-1]

    statistics = run_trials(PULL, PLAN, plant=made, trials=2)
    (machine,) = machines
    assert [reason for _, reason in statistics.failures] == [
        "the machine failed in step 3: Slow.apply has not answered for 0.05 s"
    ] * 2
    assert all(result.steps == 2 for result in statistics.results)
    assert machine.closed == 1
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    with pytest.raises(PlantError, match="SlowToReset"):
        run_trials(PULL, PLAN, plant=SlowToReset)


def test_a_machine_that_failed_and_then_does_not_close_is_given_up_too() -> None:
    class Hangs(Broken):
        patience = 0.05

        def close(self):
            super().close()
            time.sleep(2.0)
            self.waited = True

    found, plant, kept = trials(Hangs)
    assert "no such register" in str(found)  # the first error is the one to report
    assert plant.closed == len(kept) == 1
    assert not hasattr(plant, "waited")


def test_a_machine_may_ask_for_patience() -> None:
    assert run_trials(PULL, PLAN, plant=Patient).successes == 1


@pytest.mark.parametrize("patience", [0, -1.0, "a minute", np.nan, np.inf])
def test_patience_is_a_time_or_none(patience) -> None:
    with pytest.raises(InputError, match=r"Odd\.patience must be seconds > 0, or None\. Got .*; leave it out"):
        run_trials(PULL, PLAN, plant=type("Odd", (Blind,), {"patience": patience}))
    assert run_trials(PULL, PLAN, plant=type("Odd", (Blind,), {"patience": 5})).successes == 1
