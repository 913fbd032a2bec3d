"""A mode cut in two moves as before: the same states, in the half where they are."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.split import with_split
from micah_plan.automaton.transition import step
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError


@pytest.fixture(params=[("microwave", 0.5), ("drawer", 0.1), ("cabinet", 0.2), ("drawer_behind_door", 0.4)])
def model_and_place(request, repository):
    name, place = request.param
    return load_model(repository / "models" / f"{name}.yaml"), place


@pytest.mark.sweep
def test_motion_stays_as_it_was_and_the_mode_says_on_which_side_it_is(model_and_place) -> None:
    model, place = model_and_place
    split = with_split(model, 0, place)
    rng = np.random.default_rng(0)
    for _ in range(20):
        mode = own = model.modes[0].name
        x = y = np.array([0.0 if mode == "rigid" else 0.02] * model.n)
        for _ in range(25):
            u = rng.uniform(-0.15, 0.2, model.m)
            before, after = step(model, mode, x, u), step(split, own, y, u)
            mode, x, own, y = before.mode, before.x, after.mode, after.x
            assert y == pytest.approx(x, abs=1e-9)
            assert own.removesuffix(f" from {place:g}") == mode
            if mode != own:
                assert y[0] >= place - 1e-9


@pytest.mark.sweep
def test_a_split_model_is_a_model_file(model_and_place, tmp_path) -> None:
    split = with_split(model_and_place[0], 0, model_and_place[1])
    dump_model(split, tmp_path / "split.yaml")
    assert load_model(tmp_path / "split.yaml") == split


def test_effects_of_the_mode_act_in_both_halves_and_each_can_have_its_own(repository) -> None:
    microwave = load_model(repository / "models" / "microwave.yaml")
    weak = with_effect(microwave, Effect("gain", "door", (("gain", 0.8),), modes=("revolute",)))
    creep = Effect("bias", "door", (("bias", 0.01),), modes=("revolute from 0.5",))
    split = with_effect(with_split(weak, 0, 0.5), creep)
    assert split.effects[0].modes == ("revolute", "revolute from 0.5")
    assert step(split, "revolute", [0.2], [0.1]).x[0] == pytest.approx(0.28)
    assert step(split, "revolute from 0.5", [0.7], [0.1]).x[0] == pytest.approx(0.79)


def test_a_place_that_nothing_moves_through_is_refused(repository) -> None:
    with pytest.raises(InputError, match="no mode moves door through 9"):
        with_split(load_model(repository / "models" / "microwave.yaml"), 0, 9.0)
