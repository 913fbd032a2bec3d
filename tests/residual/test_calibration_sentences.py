"""Sentences of predictions and calibrations: what they say of their values."""

from __future__ import annotations

import json
import pickle

from micah_plan.message import Message, codes_of
from micah_plan.residual import messages
from micah_plan.residual.verdict import OUTCOMES


def test_message_is_its_sentence_with_code_and_values() -> None:
    said = messages.detection_limit("door", "rad", 0.01, 0.25)
    assert said == (
        "door: 0.01 rad (0.57°) more per step, or 25 % of each command, would have been detected; smaller effects "
        "cannot be excluded"
    )
    assert (said.code, said.values["share"]) == ("detection_limit", 0.25)
    assert json.loads(json.dumps([said])) == [str(said)]
    assert codes_of([said, "plain"]) == ["detection_limit", ""]


def test_message_survives_a_process_boundary() -> None:
    said: Message = pickle.loads(pickle.dumps(messages.one_run("door")))  # noqa: S301
    assert (said, said.code, dict(said.values)) == (messages.one_run("door"), "one_run", {"coordinate": "door"})


def test_missing_mode_names_the_ends_that_it_has() -> None:
    assert messages.mode_of_its_own("door", "rad", 0.5, None, 0.4, 0.0, ()) == (
        "door has a mode that the model lacks from 0.5 rad (28.6°) on: there 40 % of a command is carried out"
    )
    assert messages.mode_of_its_own("door", "rad", None, 0.5, 0.4, 0.02, ("ajar",)) == (
        "door has a mode that the model lacks up to 0.5 rad (28.6°): there 40 % of a command is carried out and "
        "0.02 rad (1.1°) added to each step; the new model has it as ajar"
    )


def test_deviation_without_rotation_mentions_none() -> None:
    assert messages.poses_off_joint("door", 0.004, 0.0) == (
        "poses deviate from the joint of door by 4 mm, depending on the configuration"
    )


def test_every_outcome_has_a_sentence() -> None:
    assert {outcome.name for outcome, _ in OUTCOMES} == set(messages.OUTCOMES)
