"""Explorations of simulated objects: truth, frames, the limit of force, faults, and what the reader says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from explore_plants import HandlePlant as Simulated
from explore_plants import Stage, Thing, drawn, track_of

from micah_plan.automaton.check import check_automaton
from micah_plan.documents.exploration_scene import load_scene
from micah_plan.documents.model import load_model, model_text
from micah_plan.errors import InputError
from micah_plan.execution.handle import HandlePlant, checked_handle_measurement
from micah_plan.execution.plant import Command, Measurement, PlantError
from micah_plan.exploration.hand import Hand
from micah_plan.exploration.run import Exploration, explore
from micah_plan.exploration.slips import Slips
from micah_plan.task.exploration_scene import Scene
from micah_plan.view.exploration_page import exploration_page

X, Y = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
DRAWER = Thing("drawer", (Stage(0.4, Y),))
HINGE = Thing("hinge_left", (Stage(0.4, Y, (0.0, 0.0, 1 / 0.4)),))
TWO = Thing("two_stage", (Stage(0.06, X), Stage(0.4, Y, (0.0, 0.0, 1 / 0.3))))
SMOOTH = Thing("two_stage", (Stage(0.06, Y), Stage(0.4, Y, (0.0, 0.0, 2.5))))  # no halt in between
LATCHED = replace(HINGE, family="latched_door", latch=20.0)
LOCKED = Thing("locked", (Stage(0.4, Y),))
SLOW = pytest.mark.slow


def run(thing: Thing, scene: Scene | None = None, seed: int = 0) -> tuple[Exploration, Simulated]:
    plant = Simulated(scene, thing)
    return explore(scene or Scene(), HandlePlant(plant), np.random.default_rng(seed)), plant


@pytest.mark.sweep
@pytest.mark.parametrize("thing", [DRAWER, HINGE, TWO, SMOOTH, LATCHED], ids=lambda thing: thing.family)
def test_it_opens_with_little_force_and_knows_the_joints(thing: Thing) -> None:
    found, plant = run(thing)
    assert (found.outcome, found.kinds) == ("opened", thing.kinds)
    assert plant.travelled >= 0.19
    assert abs(found.travel - plant.travelled) < 0.01
    assert found.probability > 0.9
    assert plant.largest_force < 45.0
    assert plant.largest_force > 20.0 or not thing.latch
    assert found.thinking < 0.5


@pytest.mark.sweep
@pytest.mark.parametrize("flex", [0.0, 4000.0])
def test_what_is_locked_is_held_and_nothing_is_claimed_of_it(flex: float) -> None:
    found, plant = run(replace(LOCKED, family="locked_flex" if flex else "locked", flex=flex))
    assert (found.outcome, found.kinds, found.model, found.travel) == ("held", (), None, 0.0)
    assert "N" in found.reason
    assert 25.0 < found.tried <= plant.largest_force + 5.0
    assert plant.largest_force <= 45.0


def test_a_turned_scene_gives_the_same_answer() -> None:
    plain, _ = run(HINGE)
    turned, _ = run(replace(HINGE, frame=(0.3, -1.2, 2.0, 1.0, -2.0, 0.5)))
    assert (plain.outcome, plain.kinds, plain.steps) == (turned.outcome, turned.kinds, turned.steps)
    assert turned.largest_force == pytest.approx(plain.largest_force, rel=1e-3)
    assert turned.probability == pytest.approx(plain.probability, abs=1e-3)


def data_of(page: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(page.split('id="page-data">')[1].split("</script>")[0])
    return data


@pytest.mark.sweep
@pytest.mark.parametrize("thing", [DRAWER, TWO, LOCKED], ids=lambda thing: thing.family)
def test_its_page_plays_each_step(thing: Thing) -> None:
    found, _ = run(thing)
    page = exploration_page(found, "a handle")
    data = data_of(page)
    assert len(data["readouts"]) == found.steps
    assert [line[0] for _, line in data["readouts"][:2]] == [f"step {k} of {found.steps}" for k in (1, 2)]
    assert ("joints" in data["layers"]) == (found.model is not None)
    assert {"hand/place", "hand/force", "way", "pulls", "fan"} <= set(data["layers"])
    assert page == exploration_page(found, "a handle")
    assert [len(frames) for frames in data["charts"]] == [found.steps] * 3


@pytest.mark.sweep
@pytest.mark.parametrize("steps", [0, 1])
def test_the_page_of_hardly_any_steps_stands_still(steps: int) -> None:
    found, _ = run(LOCKED)
    page = exploration_page(replace(found, moments=found.moments[:steps]), "a handle")
    assert data_of(page)["duration"] == 0.0
    assert page.count('<div class="chart"') == 3 * steps
    assert ("hand/force" in data_of(page)["layers"]) == bool(steps)


def test_the_same_seed_gives_the_same_model() -> None:
    texts = [model_text(found.model) for found in (run(DRAWER, seed=3)[0], run(DRAWER, seed=3)[0]) if found.model]
    assert len(texts) == 2
    assert texts[0] == texts[1]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [0, 3, *(pytest.param(seed, marks=SLOW) for seed in (1, 2, 4, 5, 6, 7, 8, 9))])
def test_no_object_meets_more_than_the_largest_force(seed: int) -> None:
    limit = 12.0 + 3.0 * seed
    found, plant = run(drawn(seed + 900), Scene(largest_force=limit, steps=60), seed)
    assert plant.largest_force <= limit
    assert found.outcome != "opened" or plant.travelled >= 0.19


@pytest.mark.sweep
@pytest.mark.parametrize("fault", ["out_nan", "out_frozen", "out_late", "slip"])
@pytest.mark.parametrize("thing", [HINGE, pytest.param(DRAWER, marks=SLOW)], ids=lambda thing: thing.family)
def test_faults_of_tracker_and_grip_are_named_and_survived(fault: str, thing: Thing) -> None:
    found, plant = run(replace(thing, fault=fault, fault_at=14))
    assert (found.outcome, found.kinds) == ("opened", thing.kinds)
    assert plant.travelled >= 0.17
    assert any(("tracker" in note) == fault.startswith("out") for note in found.notes)
    assert plant.largest_force < 45.0


@pytest.mark.sweep
@pytest.mark.parametrize("from_measured", [False, True])
@pytest.mark.parametrize("thing", [HINGE, pytest.param(LOCKED, marks=SLOW)], ids=lambda thing: thing.family)
def test_a_slip_that_no_single_look_shows_is_named(thing: Thing, from_measured: bool) -> None:
    slips = replace(thing, fault="slip", fault_at=9, position_noise=0.002, from_measured=from_measured)
    found, plant = run(slips, seed=4)
    assert [note for note in found.notes if note.startswith("step 9: the handle is seen")] == list(found.notes)
    assert (found.outcome, found.kinds) == ("held" if thing.is_locked else "opened", thing.kinds)
    assert plant.largest_force < 45.0


@pytest.mark.parametrize("slip", [0.0, 0.01])
def test_measurements_of_a_noisy_tracker_separate_a_slip_from_noise(slip: float) -> None:
    rng, slips = np.random.default_rng(0), Slips(np.zeros(3), Hand(1e-3, 0.02, 0.2))
    told = None
    for k in range(40):
        pull = rng.uniform(-0.03, 0.03, 3)  # against a handle that rests
        slips.update_displacement(pull, pull / 1.05e-3 + 0.2 * rng.standard_normal(3))
        slips.update_reading(0.003 * rng.standard_normal(3) + (np.array([slip, 0.0, 0.0]) if k >= 15 else 0.0), k + 1)
        told = told or slips.detected_slip()
    assert (told is None) == (slip == 0.0)
    if told is not None:
        assert told[0] == pytest.approx(16, abs=1)
        np.testing.assert_allclose(told[1], [slip, 0.0, 0.0], atol=0.005)


@pytest.mark.sweep
@pytest.mark.parametrize(("fault", "said"), [("lost", "lost the handle"), ("dies", "controller stopped")])
def test_a_lost_handle_and_a_dead_plant_end_it_with_a_reason(fault: str, said: str) -> None:
    found, plant = run(replace(HINGE, fault=fault, fault_at=14))
    assert found.outcome == "gave_up"
    assert said in found.reason
    assert plant.largest_force < 45.0


def test_a_tracker_that_is_out_while_commands_count_from_what_it_sees_raises_no_force() -> None:
    thing = replace(drawn(705, "hinge_right"), fault="out_nan", fault_at=9)
    found, plant = run(thing, seed=705)
    assert thing.from_measured
    assert plant.largest_force < 45.0
    assert found.outcome == "opened"


def test_a_handle_that_is_lost_on_the_way_is_not_called_opened() -> None:
    found, plant = run(replace(drawn(707, "hinge_below"), fault="lost"), seed=707)
    assert found.outcome == "gave_up"
    assert plant.travelled < 0.19


@pytest.mark.parametrize("seed", [700, *(pytest.param(seed, marks=SLOW) for seed in (703, 705))])
def test_no_motion_is_claimed_from_force_alone(seed: int) -> None:
    found, plant = run(replace(drawn(seed, "latched_door"), fault="lost", fault_at=9), seed=seed)
    assert (found.outcome, found.kinds, found.travel, found.model) == ("gave_up", (), 0.0, None)
    assert plant.travelled < 0.01


def test_a_hand_that_never_held_the_handle_gives_up() -> None:
    found, _ = run(replace(HINGE, fault="lost", fault_at=1))
    assert found.outcome == "gave_up"
    assert "hand" in found.reason


def test_commands_that_count_from_the_measured_place_are_noticed() -> None:
    found, plant = run(replace(HINGE, from_measured=True, position_noise=0.003, stiffness=2000.0))
    assert found.hand.from_measured
    assert (found.outcome, found.kinds) == ("opened", ("revolute",))
    assert 1.0 / found.hand.compliance == pytest.approx(2000.0, rel=0.1)
    assert plant.largest_force < 45.0


@pytest.mark.parametrize("seed", [3141, pytest.param(3163, marks=SLOW)])
def test_a_soft_hand_that_counts_from_measured_places_is_neither_refused_nor_held_back(seed: int) -> None:
    thing = drawn(seed, "latched_drawer")
    found, plant = run(thing, seed=seed)
    assert thing.from_measured
    assert (found.outcome, found.kinds) == ("opened", ("prismatic",))
    assert plant.largest_force < 45.0


@pytest.mark.parametrize(("seed", "noise"), [(3006, 2), pytest.param(3292, 76, marks=SLOW)])
def test_a_second_joint_is_found_where_the_other_end_had_been_tried_first(seed: int, noise: int) -> None:
    found, _ = run(drawn(seed, "two_stage"), seed=noise)
    assert (found.outcome, found.kinds) == ("opened", ("prismatic", "revolute"))


def test_forces_of_the_wrong_sign_are_named() -> None:
    class Reversed(Simulated):
        def _measure(self) -> Measurement:
            seen = super()._measure()
            return replace(seen, force=-seen.force)

    found = explore(Scene(), HandlePlant(Reversed(None, DRAWER)), np.random.default_rng(0))
    assert found.outcome == "gave_up"
    assert "against the commands" in found.reason


def test_a_door_that_was_ajar_is_opened_the_other_way() -> None:
    found, plant = run(replace(HINGE, start=0.02), seed=1)
    assert (found.outcome, found.kinds) == ("opened", ("revolute",))
    assert plant.travelled >= 0.19


@pytest.mark.sweep
@pytest.mark.parametrize("thing", [DRAWER, HINGE, TWO, LATCHED], ids=lambda thing: thing.family)
def test_the_model_is_an_automaton_that_a_file_keeps(thing: Thing, tmp_path: Path) -> None:
    found, _ = run(thing)
    assert found.model is not None
    check_automaton(found.model)
    path = tmp_path / "model.yaml"
    path.write_text(model_text(found.model))
    model = load_model(path)
    assert [name.partition("_")[0] for name in model.mode_names if name != "rigid"] == list(thing.kinds)
    assert ("rigid" in model.mode_names) == bool(thing.latch)
    (effect,) = model.effects
    assert effect.name == "dead_zone"
    assert effect.values[0] > 0.0
    joint = next(mode for mode in model.modes if mode.name != "rigid").joints[0]
    assert joint.covariance is not None
    truth = track_of(thing.stages)
    assert abs(np.linalg.norm(truth.place[-1])) > 0.2
    if thing.kinds[0] == "prismatic":
        assert np.degrees(np.arccos(np.clip(joint.axis @ np.array(thing.stages[0].direction), -1, 1))) < 4.0


def test_answers_without_a_pose_become_nan_and_without_a_force_are_refused() -> None:
    seen = Measurement(1.0, np.full((1, 3), np.nan), np.array([[0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 3)))
    assert np.isnan(checked_handle_measurement(seen).quaternion).all()
    with pytest.raises(InputError, match="needs measured forces"):
        checked_handle_measurement(replace(seen, force=None))
    with pytest.raises(InputError, match="shape"):
        checked_handle_measurement(replace(seen, position=np.zeros((2, 3))))


def test_a_broken_line_is_a_failure_of_the_machine() -> None:
    class Broken(Simulated):
        def apply(self, command: Command) -> Measurement:
            raise ConnectionResetError(f"the line is dead, {command.handle.shape}")

    plant = HandlePlant(Broken(None, DRAWER))
    plant.reset(np.random.default_rng(0))
    with pytest.raises(PlantError, match="the line is dead"):
        plant.apply(Command(np.zeros(3), np.zeros((1, 3)), np.zeros((1, 3))))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("largest_force: -1", "line 2.*largest_force.*> 0"),
        ("steps: 0", "line 2.*steps.*>= 1"),
        ("force: 3", "line 2.*unknown key 'force'"),
        ("opening: .nan", "line 2.*opening"),
        ("workspace: {low: [0, 0, 0], high: [1, 0, 1]}", "line 2.*in y"),
        ("simulated: nowhere.yaml", "line 2.*simulated"),
        ("holds: {position: [0, 0]}", "line 2.*position"),
    ],
)
def test_scenes_that_cannot_be_used_are_refused_with_their_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"format: micah-plan/scene/1\n{text}\n")
    with pytest.raises(InputError, match=said):
        load_scene(path)


def test_a_handle_outside_of_the_workspace_is_refused() -> None:
    with pytest.raises(InputError, match="outside of the workspace"):
        run(DRAWER, Scene(low=(1.0, 1.0, 1.0)))


@pytest.mark.slow
def test_a_drawer_that_is_too_short_is_reported_with_its_travel() -> None:
    found, _ = run(Thing("drawer", (Stage(0.12, Y),)))
    assert (found.outcome, found.kinds) == ("gave_up", ("prismatic",))
    assert found.travel == pytest.approx(0.12, abs=0.01)


@pytest.mark.slow
def test_a_tracker_that_is_far_noisier_than_thought_is_no_lost_handle() -> None:
    found, _ = run(replace(HINGE, position_noise=0.01, rotation_noise=0.1, force_noise=1.0))
    assert found.outcome == "opened"


def test_the_shipped_scene_has_its_required_sizes(repository: Path) -> None:
    scene = load_scene(repository / "problems" / "explore_handle.yaml")
    assert (scene.largest_force, scene.largest_step, scene.steps, scene.opening) == (45.0, 0.05, 300, 0.2)
    assert scene.simulated is not None
