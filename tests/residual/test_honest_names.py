"""A name is given only to what the recording can tell from everything else."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute
from micah_plan.automaton.tracks import tracks
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.candidates import candidates, indistinguishable
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.examined import examined

SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
TURN = np.array([[np.cos(0.6), np.sin(0.6), 0.0], [-np.sin(0.6), np.cos(0.6), 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def door():
    """Swings from 0 to 1.2 rad."""
    only = Segment(SWING, 0, 0, 99, 0.0, plants.LENGTH, (0.0, plants.LENGTH), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (only,)),)))


def data_of(door, **how):
    moved = plants.runs_of(plants.honest, 4, 40, 1, noise=0.001)
    (data,) = coordinate_data_of(door, tracks(door, plants.door_recording(moved, **how)))
    return data, {part.name: part for part in candidates(data)}


def test_actions_along_the_joint_do_not_determine_their_frame(door) -> None:
    for turn in (None, TURN):
        data, able = data_of(door, turn=turn)
        assert "frame_rotation" not in able
        # Then a turn and a gain are the same.
        assert "frame_rotation" in indistinguishable(able["gain"], data)


def test_actions_across_the_joint_determine_their_frame(door) -> None:
    data, able = data_of(door, turn=TURN, press=0.3 * plants.RADIUS * plants.STEP)
    assert "frame_rotation" in able
    assert "frame_rotation" not in indistinguishable(able["gain"], data)


@pytest.mark.slow
def test_a_curve_that_no_effect_has_is_not_explained(door) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.tiring, 4, 20, 2, noise=0.001)))
    assert found.verdict in ("partly", "unexplained")
    assert found.automaton.effects[-1].name == "unexplained"
    assert found.after.one_step < 1.15 * found.noise_floor < 0.8 * found.before.one_step


def alike(count, rows, seed):
    """Runs of a sagging hinge that all make the same motion."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        c, z = 0.1, []
        for _ in range(rows):
            z.append(c + 0.001 * rng.standard_normal())
            c += 0.05 - 0.03 * np.cos(2.0 * c)
        found.append((np.array(z), np.full(rows, 0.05)))
    return found


@pytest.mark.slow
def test_runs_that_are_all_alike_do_not_separate_place_from_time(door) -> None:
    found = calibrate(door, plants.door_recording(alike(4, 15, 0)))
    assert found.traces[0].data.repeats_one_motion
    assert found.verdict == "partly"
    assert not any(effect.is_added for effect in found.effects)
    assert found.automaton == door
    assert "remembered" in [note.values["outcome"] for note in found.notes if note.code == "effects_not_added"]
    data, _ = data_of(door)
    assert not data.repeats_one_motion


def test_the_search_for_a_grip_starts_where_the_part_lets_go(door) -> None:
    moved = plants.runs_of(plants.sticking, 6, 50, 3, noise=0.002)
    (data,) = coordinate_data_of(door, tracks(door, plants.door_recording(moved)))
    (part,) = (one for one in candidates(data) if one.name == "stick_slip")
    assert np.abs(part.starts[:, 0] - 0.07).min() < 0.003


@pytest.mark.slow
def test_sticking_is_no_play(door) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.sticking, 6, 50, 3, noise=0.002)))
    assert [one.effect.name for one in found.effects] == ["stick_slip"]
    assert found.effects[0].effect.values[0] == pytest.approx(0.07, rel=0.05)
    assert found.verdict == "explained"


@pytest.mark.slow
def test_commands_away_from_an_end_that_do_nothing_are_reported(door) -> None:
    """Few rows of many: no smooth function of the configuration is as sharp."""

    def clinging(c, u, _, memory):
        memory["held"] = (memory.get("held", False) or c <= 0.0) and u <= 0.03
        return 0.0 if memory["held"] else c + u

    for plant, is_noise in ((clinging, False), (plants.honest, True)):
        moved = plants.runs_of(plant, 12, 60, 2, noise=0.004, goals=(-0.1, 0.7))
        (one,) = examined(door, plants.door_recording(moved)).innovation_tests
        assert one[1].is_noise is is_noise


@pytest.mark.parametrize("seed", [3, 5, 7])
def test_what_makes_single_steps_longer_is_not_all(door, seed) -> None:
    """A sway in time looks like a reading that wanders, if places bring the part back: roll-outs alone get shorter."""
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.swaying, 6, 90, seed)))
    assert found.verdict == "partly"
    assert found.traces[0].outcome.name in ("noisier", "not white")
    assert found.effects[0].is_added
    assert found.after.rollout < 0.5 * found.before.rollout


def test_what_makes_both_shorter_is_all(door) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.loose, 6, 90, 3)))
    assert found.verdict == "explained"
    assert found.after.one_step < found.before.one_step


@pytest.mark.parametrize("seed", [0, 1])
def test_what_makes_roll_outs_longer_is_not_added(door, seed) -> None:
    """Commands that were written down with errors of their own: single steps are likelier if they are smoothed."""
    rng = np.random.default_rng([seed, 7])
    runs = []
    for run in range(6):
        side = 1.0 if run % 2 == 0 else -1.0
        steps = 0.01 * rng.uniform(0.6, 1.2) * (1.0 + 0.3 * rng.standard_normal(90))
        c = (0.1 if side > 0 else 1.1) + side * np.concatenate([[0.0], np.cumsum(steps[:-1])])
        c = np.clip(c, 0.01, 1.19)
        told = np.append(np.diff(c), 0.0) + 0.01 * rng.standard_normal(90)
        runs.append((c + 0.003 * rng.standard_normal(90), told))
    found = calibrate(door, plants.door_recording(runs))
    assert found.verdict == "partly"
    assert found.traces[0].outcome.name == "longer"
    assert found.effects
    assert not any(effect.is_added for effect in found.effects)
    assert found.after == found.before
