"""The story of the page "Start" on other machines and seeds: what is wrong with them is named.

The machines are the worn drawer of the examples, with other things in the place of its play.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from micah_plan import calibrate, execute, learn, predict, solve

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def worn_drawer() -> Any:
    sys.path.append(str(ROOT / "examples"))
    from worn_drawer import WornDrawer

    return WornDrawer


def machine(worn_drawer: Any, name: str) -> Any:
    """A class of the machine with another mechanism."""

    class DeadZone(worn_drawer):  # type: ignore[misc]
        def carried(self, pull: float) -> float:
            return float(np.sign(pull)) * max(abs(pull) - 0.006, 0.0)

    class Late(worn_drawer):  # type: ignore[misc]
        def reset(self, rng: np.random.Generator) -> Any:
            self.pulls = [0.0, 0.0]
            return super().reset(rng)

        def carried(self, pull: float) -> float:
            self.pulls.append(pull)
            return self.pulls[-3]

    return {"backlash": worn_drawer, "dead_zone": DeadZone, "delay": Late}[name]


SIZES = {"backlash": 0.025, "dead_zone": 0.006, "delay": 2.0}


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.evidence) for k in (1, 2))])
@pytest.mark.parametrize("name", SIZES)
@pytest.mark.slow
def test_what_is_wrong_with_a_machine_is_named(worn_drawer: Any, name: str, seed: int) -> None:
    plant, close = machine(worn_drawer, name), ROOT / "problems" / "drawer_open.yaml"
    demonstration = ROOT / "examples" / "demonstrations" / "drawer.csv"
    drawer = learn(demonstration, parts=ROOT / "models" / "parts" / "drawer.yaml", seed=seed)
    runs = execute(solve(close, model=drawer, seed=seed), plant=plant, trials=8, seed=seed)
    first = calibrate(drawer, runs)
    assert any(name in (one.effect.name, *one.tied) for one in first.effects)
    # What cannot be told apart is asked for; where all is told, nothing is.
    assert (first.experiment is None) == (not any(one.tied for one in first.effects))
    answers = [first]
    if first.experiment is not None:
        asked = execute(first.experiment, plant=plant, seed=seed)
        assert asked.success
        # Together, and one after the other: what the first calibration took for it is put right.
        answers = [calibrate(drawer, [runs, asked]), calibrate(first, asked)]
    for better in answers:
        # The rail is longer than the demonstration showed: that its end is further away may be found as well.
        found = {one.effect.name: one.effect.values for one in better.effects if one.is_added}
        assert found.keys() - {"guard_shift"} == {name}
        # Pulled one way, only the half of the play shows that the hand takes up.
        size = SIZES[name] * (0.5 if name == "backlash" and found[name][1] != 0.0 else 1.0)
        assert found[name][0] == pytest.approx(size, rel=0.15)
        after = execute(solve(close, model=better, seed=seed), plant=plant, trials=8, seed=seed + 10)
        assert predict(better, after).outcome != "lacking"  # or too few rows to tell


def test_an_experiment_is_for_a_class_and_has_no_options_of_plans(worn_drawer: Any) -> None:
    from micah_plan import InputError, load

    experiment: Any = load(ROOT / "problems" / "experiments" / "drawer.yaml")
    found = execute(experiment, plant="nominal", trials=1)
    assert (found.success, found.outcome, found.reason) == (True, "carried_out", "")
    assert len(found.recording.runs) == len(experiment.motions)
    assert found.json()["rows"] == len(found.recording)
    assert f"{len(found.recording.runs)} runs carried out, 0 aborted" in str(found)
    again = execute(ROOT / "problems" / "experiments" / "drawer.yaml", plant="nominal", trials=1)
    assert again.json()["rows"] == found.json()["rows"]
    assert "Experiment" in found.page()
    assert found.plot().axes
    with pytest.raises(InputError, match="start is for plans, this is an experiment; omit start"):
        execute(experiment, start={"drawer": 0.1})  # type: ignore[call-overload]
    with pytest.raises(InputError, match="does not know where each motion of an experiment starts; give its class"):
        execute(experiment, plant=worn_drawer(experiment.problem(0)))
