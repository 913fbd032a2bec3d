"""Effects that began: the written model predicts its own recording as it was, and later ones as the object is now."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect, Since
from micah_plan.documents.model import load_model, model_text
from micah_plan.errors import InputError
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.onsets import effects_with_onset, with_onset_digest
from micah_plan.residual.prediction import predict_recording, rmse


def weaker(since_run: int, factor: float = 0.85):
    def moves(c, u, _, memory):
        return c + (factor if memory["run"] >= since_run else 1.0) * u

    return moves


def rolled(automaton, recording) -> float:
    return rmse([run.rollout.configuration for run in predict_recording(automaton, recording)])


@pytest.fixture(scope="module")
def dropped():
    return plants.door_recording(plants.runs_of(weaker(5), 10, 50, 0))


@pytest.fixture(scope="module")
def found(door, dropped):
    return calibrate(door, dropped)


@pytest.mark.slow
def test_the_written_model_is_as_good_as_reported_on_its_own_recording(found, dropped, tmp_path) -> None:
    (effect,) = found.automaton.effects
    assert effect.name == "gain"
    assert effect.since is not None
    assert effect.since.run == 6  # the sixth: plants count runs from 0
    path = tmp_path / "new.yaml"
    path.write_text(model_text(found.automaton))
    written = load_model(path)
    assert written.effects == found.automaton.effects
    assert rolled(written, dropped) == pytest.approx(found.after.rollout, rel=0.1)
    always = replace(written, effects=(replace(effect, since=None),))
    assert rolled(always, dropped) > 2.0 * rolled(written, dropped)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_a_small_change_between_two_runs_is_dated_between_them(door, seed) -> None:
    """Rows alone would date it some later: that something changed while nobody looked is as likely as within a run."""
    recording = plants.door_recording(plants.runs_of(weaker(5, 0.9), 10, 30, seed))
    (effect,) = calibrate(door, recording).effects
    assert (effect.effect.since.run, effect.effect.since.time) == (6, 0.0)


def weaker_from(first_run: int, row: int, *, in_each: bool = False):
    def moves(c, u, k, memory):
        began = k >= row if in_each else (memory["run"], k) >= (first_run, row)
        return c + (0.75 if began else 1.0) * u

    return moves


@pytest.mark.slow
@pytest.mark.parametrize(("run", "row"), [(4, 25), pytest.param(0, 30, marks=pytest.mark.evidence)])
def test_what_began_within_a_run_is_dated_to_a_few_rows(door, run, row) -> None:
    recording = plants.door_recording(plants.runs_of(weaker_from(run, row), 8, 50, 3))
    found = calibrate(door, recording)
    (effect,) = found.effects
    assert (found.verdict, effect.effect.name, effect.effect.since.run) == ("explained", "gain", run + 1)
    assert dict(effect.effect.parameters)["gain"] == pytest.approx(0.75, abs=0.02)
    times = recording.select(run=run + 1).time
    assert np.abs(effect.effect.since.time - (times - times[0])[row]) <= 4.0 * (times[1] - times[0])


@pytest.mark.slow
def test_effects_that_start_again_in_each_run_are_dated_in_all(door) -> None:
    recording = plants.door_recording(plants.runs_of(weaker_from(0, 20, in_each=True), 6, 50, 3))
    (effect,) = calibrate(door, recording).effects
    times = recording.select(run=1).time
    assert effect.effect.since.run is None
    assert np.abs(effect.effect.since.time - (times - times[0])[20]) <= 3.0 * (times[1] - times[0])


@pytest.mark.slow
def test_what_began_within_the_last_run_no_other_run_bears_out(door) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(weaker_from(7, 20), 8, 50, 3)))
    assert found.verdict in ("unexplained", "partly")
    assert not any(effect.is_added for effect in found.effects)


@pytest.mark.slow
def test_errors_of_poses_have_it_from_there_on(found, dropped) -> None:
    _, _, before, after = found.pose_errors[0]
    runs = predict_recording(found.automaton, dropped)
    assert after.rollout == pytest.approx(rmse([run.rollout.position for run in runs]))
    assert after.rollout < 0.5 * before.rollout


@pytest.mark.slow
def test_some_runs_are_predicted_as_a_part_of_their_recording(found, dropped) -> None:
    several = predict_recording(found.automaton, dropped, runs=(3, 7))
    of_all = [run for run in predict_recording(found.automaton, dropped) if run.run in (3, 7)]
    assert [run.run for run in several] == [3, 7]
    for one, same in zip(several, of_all, strict=True):
        np.testing.assert_allclose(one.rollout.configuration, same.rollout.configuration, atol=1e-12)


def worn_since(*changes):
    """A gain of 0.8, and of 0.7 of that from each of some (run, row) on."""

    def moves(c, u, k, memory):
        return c + 0.8 * 0.7 ** sum((memory["run"], k) >= since for since in changes) * u

    return moves


@pytest.mark.slow
def test_an_effect_that_changes_is_the_same_effect_once_more(door) -> None:
    recording = plants.door_recording(plants.runs_of(worn_since((4, 20)), 8, 50, 3))
    found = calibrate(door, recording)
    always, later = sorted((e.effect for e in found.effects), key=lambda effect: effect.since is not None)
    assert found.verdict == "explained"
    assert (always.name, always.since, later.name, later.since.run) == ("gain", None, "gain", 5)
    assert (always.values[0], later.values[0]) == pytest.approx((0.8, 0.7), abs=0.02)
    assert len(found.automaton.effects) == 2
    assert rolled(found.automaton, recording) == pytest.approx(found.after.rollout, rel=0.2)
    now = plants.door_recording(plants.runs_of(worn_since((0, 0)), 6, 50, 1))
    assert rolled(found.automaton, now) < 0.2 * rolled(door, now)


@pytest.mark.evidence
def test_what_turns_round_shows_in_no_mean(door) -> None:
    def moves(c, u, _, memory):
        return c + u + (0.012 if memory["run"] < 4 else -0.012)

    found = calibrate(door, plants.door_recording(plants.runs_of(moves, 8, 50, 3)))
    always, later = sorted((e.effect for e in found.effects), key=lambda effect: effect.since is not None)
    assert (found.verdict, always.name, later.name, later.since.run) == ("explained", "bias", "bias", 5)
    assert (always.values[0], later.values[0]) == pytest.approx((0.012, -0.024), abs=0.002)


@pytest.mark.evidence
def test_what_changed_twice_may_go_on_changing(door) -> None:
    recording = plants.door_recording(plants.runs_of(worn_since((2, 20), (5, 10)), 8, 50, 3))
    found = calibrate(door, recording)
    assert found.verdict == "partly"


@pytest.mark.evidence
@pytest.mark.parametrize(
    "share_of_run",
    [
        lambda run: 1.0 - 0.5 * np.exp(-run / 2.0),  # it warms up
        lambda run: 1.0 - 0.05 * run,  # it wears
    ],
)
def test_what_changes_little_by_little_is_written_as_it_is_in_the_last_runs(door, share_of_run) -> None:
    def moves(c, u, _, memory):
        return c + share_of_run(memory["run"]) * u

    found = calibrate(door, plants.door_recording(plants.runs_of(moves, 10, 50, 3)))
    assert found.verdict in ("partly", "unexplained")
    gains = [dict(effect.parameters).get("gain", 1.0) for effect in found.automaton.effects]
    assert np.prod(gains) == pytest.approx(np.mean([share_of_run(run) for run in (7, 8, 9)]), abs=0.15)


@pytest.mark.slow
def test_nothing_is_left_to_find_with_the_written_model(found, dropped) -> None:
    again = calibrate(found.automaton, dropped)
    assert again.verdict == "none"
    assert again.effects == ()


def test_later_recordings_have_it_from_the_start(door, found) -> None:
    later = plants.door_recording(plants.runs_of(weaker(0), 6, 50, 1))
    assert effects_with_onset(found.automaton, later) == ()
    assert rolled(found.automaton, later) < 0.3 * rolled(door, later)


def test_runs_that_were_set_aside_change_nothing(found, dropped) -> None:
    fewer = dropped.rows(~np.isin(dropped.run, [2, 8]))
    assert len(effects_with_onset(found.automaton, fewer)) == 1
    assert rolled(found.automaton, fewer) == pytest.approx(rolled(found.automaton, dropped), rel=0.3)


def test_a_run_in_the_middle_of_which_it_began_is_predicted_in_two_parts(door, dropped) -> None:
    at = float(dropped.select(run=5).time[20] - dropped.select(run=5).time[0])
    effect = with_onset_digest(Effect("gain", "door", (("gain", 0.85),), since=Since(at, 5)), dropped)
    runs = predict_recording(with_effect(door, effect), dropped)
    assert [run.run for run in runs] == [1, 2, 3, 4, 5, 5, 6, 7, 8, 9, 10]
    assert [len(run.time) for run in runs][4:6] == [21, len(dropped.select(run=5).time) - 20]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gain", "delay", "sensor_scale"])
def test_what_begins_in_each_run_does_so_in_every_recording(door, dropped, name: str) -> None:
    values = {"gain": ("gain", 0.5), "delay": ("steps", 2.0), "sensor_scale": ("scale", 0.8)}[name]
    begun = with_effect(door, Effect(name, "door", (values,), since=Since(1e6)))
    assert rolled(begun, dropped) == rolled(door, dropped)
    always = replace(begun, effects=(replace(begun.effects[0], since=Since(0.0)),))
    plain = with_effect(door, Effect(name, "door", (values,)))
    assert rolled(always, dropped) == rolled(plain, dropped) != rolled(door, dropped)


def test_what_changes_the_model_itself_cannot_begin(door) -> None:
    shift = Effect("guard_shift", "door", (("shift", -0.1), ("side", 1.0)))
    assert with_effect(door, shift).effects == (shift,)
    with pytest.raises(InputError, match="guard_shift changes the model itself, so it cannot begin"):
        with_effect(door, replace(shift, since=Since(1.0)))


def test_a_run_and_the_digest_of_its_rows_go_together(found, tmp_path) -> None:
    text, path = model_text(found.automaton), tmp_path / "new.yaml"
    run, digest = "      run: 6\n", f"      digest: {found.automaton.effects[0].since.digest}\n"
    path.write_text(text.replace(run, "").replace(digest, ""))
    assert load_model(path).effects[0].since == Since(0.0)
    for line, lacking in ((run, "run"), (digest, "digest")):
        path.write_text(text.replace(line, ""))
        with pytest.raises(InputError, match=rf"effects\.0\.since.*found no {lacking}"):
            load_model(path)
    path.write_text(text.replace(digest, "      digest: of old\n"))
    with pytest.raises(InputError, match=r"effects\.0\.since\.digest"):
        load_model(path)
