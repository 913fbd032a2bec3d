"""A model that was calibrated on a recording which could not tell two effects apart is calibrated on one that can."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError
from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate

STEP = 0.021
DELAY = Effect("delay", "door", (("steps", 1.4),), (0.1,), tied=("backlash",))


def runs_one_way(plant, seed):
    """Runs that push on in equal steps: play, which costs the first steps, is a delay here."""
    rng = np.random.default_rng(seed)
    runs = []
    for run in range(5):
        c, memory, z, u = rng.uniform(0.1, 0.3), {"run": run, "rng": rng}, np.zeros(14), np.full(14, STEP)
        for k in range(len(z)):
            z[k] = c + 0.003 * rng.standard_normal()
            c = plant(c, u[k], k, memory) + 0.001 * rng.standard_normal()
        runs.append((z, u))
    return plants.door_recording(runs)


def to_and_fro(plant, seed):
    return plants.door_recording(plants.runs_of(plant, 8, 40, seed))


def test_play_that_was_taken_for_a_delay_is_play_once_a_recording_shows_it(door, tmp_path) -> None:
    once = calibrate(door, runs_one_way(plants.loose, 4))
    (found,) = once.effects
    assert {found.effect.name, *found.tied} == {"delay", "backlash"}
    dump_model(once.automaton, tmp_path / "once.yaml")
    again = calibrate(load_model(tmp_path / "once.yaml"), to_and_fro(plants.loose, 101))
    assert again.verdict == "explained"
    (effect,) = again.automaton.effects
    assert effect.name == "backlash"
    assert effect.values[0] == pytest.approx(0.06, abs=0.003)
    assert again.before.rollout > 2.0 * again.after.rollout
    assert codes_of(again.notes)[0] == "earlier_effects_estimated_anew"


@pytest.mark.slow
def test_of_two_tied_effects_the_one_of_the_next_recording_is_written(door) -> None:
    once = calibrate(door, to_and_fro(plants.sprung, 3))
    (found,) = once.effects
    assert (found.effect.name, found.tied) == ("gravity", ("spring",))
    again = calibrate(once.automaton, to_and_fro(plants.sprung, 4))
    assert [effect.name for effect in again.automaton.effects] == ["spring"]
    assert codes_of(again.notes)[0] == "earlier_effects_estimated_anew"


@pytest.mark.slow
def test_of_two_that_stay_tied_the_written_one_is_kept(door) -> None:
    once = calibrate(door, to_and_fro(plants.sprung, 5))
    assert [(one.effect.name, one.tied) for one in once.effects] == [("gravity", ("spring",))]
    again = calibrate(once.automaton, to_and_fro(plants.sprung, 6))
    assert again.verdict == "none"
    assert again.automaton == once.automaton


def test_a_delay_that_is_one_stays_one(door) -> None:
    again = calibrate(with_effect(door, DELAY), to_and_fro(plants.late, 101))
    (effect,) = again.automaton.effects
    assert effect.name == "delay"
    assert effect.values[0] == pytest.approx(2.0, abs=0.05)


def test_what_an_earlier_recording_showed_alone_is_not_dropped(door) -> None:
    weak = with_effect(door, Effect("gain", "door", (("gain", 0.8),), (0.01,)))
    again = calibrate(weak, to_and_fro(plants.honest, 101))
    assert "gain" in [effect.name for effect in again.automaton.effects]


def test_effects_written_by_a_person_are_not_estimated_again(door) -> None:
    told = with_effect(door, Effect("delay", "door", (("steps", 1.4),)))
    again = calibrate(told, to_and_fro(plants.loose, 101))
    assert told.effects[0] in again.automaton.effects


def test_an_effect_can_be_tied_only_with_one_that_exists(door, tmp_path) -> None:
    path = tmp_path / "model.yaml"
    dump_model(with_effect(door, DELAY), path)
    path.write_text(path.read_text().replace("[backlash]", "[backlach]"))
    with pytest.raises(InputError, match=r"effects\.0\.tied\.0.*backlach"):
        load_model(path)
