"""Sentences of all packages: what they say of their values, in one line of plain English."""

import inspect
import json
import pickle
import typing
from copy import deepcopy
from importlib import import_module

import pytest

from micah_plan.automaton import messages as of_automaton
from micah_plan.execution import messages as of_execution
from micah_plan.exploration import messages as of_exploration
from micah_plan.learning import messages as of_learning
from micah_plan.message import Message, code_of, codes_of
from micah_plan.planning import messages as of_planning
from micah_plan.recording import messages as of_recording
from micah_plan.robot import messages as of_robot
from micah_plan.task import messages as of_task

PACKAGES = ("automaton", "execution", "exploration", "learning", "planning", "recording", "residual", "robot", "task")
# Values of each type of parameter, and of a parameter by name.
EXAMPLES = {str: "door", int: 3, float: 0.25, bool: True, "outcome": "nothing"}
# Words of a dialect in which messages once were written: a reader has to guess what stands behind them.
VAGUE = ("whatever it", "in turn", "say so", "says", "tells", "anew", "beside", "told")


def _functions():
    for package in PACKAGES:
        module = import_module(f"micah_plan.{package}.messages")
        for name, function in vars(module).items():
            is_own = getattr(function, "__module__", "") == module.__name__
            if inspect.isfunction(function) and is_own and hasattr(function, "__wrapped__"):
                yield pytest.param(function, id=f"{package}.{name}")


def _example(kind):
    """A value of a parameter's type."""
    if kind in EXAMPLES:
        return EXAMPLES[kind]
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if type(None) in arguments:
        return _example(next(one for one in arguments if one is not type(None)))
    if origin is tuple and Ellipsis not in arguments:
        return tuple(map(_example, arguments))
    if origin is tuple:
        return (_example(arguments[0]),) * 2
    if origin is not None and arguments and origin is not typing.Literal:
        return [_example(arguments[0])]
    return arguments[0] if arguments else ""


@pytest.mark.parametrize("function", [*_functions()])
def test_a_message_is_one_plain_line_with_its_code_and_values(function) -> None:
    hints = typing.get_type_hints(function.__wrapped__)
    names = list(inspect.signature(function).parameters)
    found = function(**{name: EXAMPLES.get(name) or _example(hints[name]) for name in names})
    assert (code_of(found), list(found.values)) == (function.__name__, names)
    assert found
    assert found == " ".join(found.split())
    assert not found.endswith(".")
    assert not [word for word in VAGUE if word in found]
    assert pickle.loads(pickle.dumps(found)).code == deepcopy(found).code == found.code  # noqa: S301
    assert json.loads(json.dumps(found)) == str(found)


SENTENCES = [
    (
        of_planning.corridor_too_narrow("'wall'", 0.02, 0.05, "m", 0.95),
        "the corridor at 'wall' is 20 mm wide, but the belief needs 50 mm at 95 %",
    ),
    (
        of_planning.guard_not_entered("'latch'", -0.01, 0.02, "m"),
        "the mean stops 10 mm before 'latch', but the transition needs 20 mm past it",
    ),
    (
        of_planning.no_room_to_reverse("'wall'", ("a", "b"), -0.01, 0.02, "m", 0.9),
        "behind 'wall' the same input moves the other way ('a' and 'b'), so a single step must cross it: the step "
        "starts 10 mm behind it, but the belief needs 20 mm at 90 %",
    ),
    (
        of_planning.misses_goal(0.25, "door", "", 0.9, 0.2, 0.1, "m"),
        "25 % of the roll-outs end outside the goal for 'door': 90 % are within 200 mm, its tolerance is 100 mm",
    ),
    (of_planning.breaks_constraint(1.0, "slow", None, "m"), "100 % of the roll-outs violate 'slow'"),
    (
        of_planning.constraint_in_the_way(("wall", "shelf")),
        "the reachable modes lead to the goal only without 'wall' (or without 'shelf')",
    ),
    (of_planning.too_few_revisits(1), "no inputs lead to the goal if each mode is entered at most 2 times"),
    (
        of_execution.with_misses(of_execution.stopped_confident(0.95), [of_execution.not_felt()]),
        "stopped with 95 % probability of the goal, but no contact was felt on the way down, so it was not released",
    ),
    (
        of_execution.part_turned("door", 3.0, True),
        "part 'door' is measured turned by 3 rad (172°) against its joint; the quaternion has its scalar first; give "
        "it last",
    ),
    (of_execution.in_other_mode("free", ("shut",), False), "the believed mode is free, not shut"),
    (of_execution.refused_plans(["x"]), "; a new plan was refused because x"),
    (of_execution.refused_plans(["x", "y"]), "; 2 new plans were refused, the last because y"),
    (of_exploration.nothing_moved(40.0), "nothing moved it with up to 40 N; a latch that holds more is not excluded"),
    (of_exploration.blind_until(1, 7), "the tracker saw nothing for 1 step, until step 7"),
    (
        of_robot.joint_limit(3, 0.02, 0.0, [("elbow", "upper")]),
        "the tool stays 20 mm and 0 rad from its pose at knot 3: joint limit of 'elbow' (upper)",
    ),
    (of_robot.collision(("arm", "shelf"), -0.01, 2), "arm meets shelf, 10 mm deep, at knot 2"),
    (of_robot.collision(("arm", "shelf"), 0.01, 2), "arm comes within 10 mm of shelf, at knot 2"),
    (
        of_task.start_in_no_mode("door = 2 ± 0.1 rad", ["open", "shut"]),
        "the start door = 2 ± 0.1 rad is in the range of no mode ('open', 'shut')",
    ),
    (
        of_recording.repeats(4, "part 'door'", None, ", most of them row 9 (t = 0.9 s)", False),
        "4 rows of part 'door' repeat the pose of the row before to the last digit, most of them row 9 (t = 0.9 s): "
        "was the part out of sight? Repeated rows do not count as measurements",
    ),
    (
        of_recording.stray("part 'door'", 0.2, 0.0, "row 3 (t = 0.3 s)", 1, True),
        "part 'door' is 200 mm away in row 3 (t = 0.3 s) (and in 1 more piece), where it cannot get: did the tracker "
        "lose it, or mistake it for another? These rows are not used",
    ),
    (
        of_recording.clock_offset("door", 0.125, 0.01, None),
        "commands of door: their clock is 0.125 s ahead (as given)",
    ),
    (
        of_automaton.effect_left_out("delay", "door", True),
        "planner, filter and nominal plant leave out the delay of door: it depends on earlier inputs",
    ),
    (
        of_learning.small_motion("door", 0.01, None, (0.004, 0.02)),
        "part 'door' moves over 10 mm, hardly more than a tracker is assumed to wander: its stops and its kind of "
        "joint may be missed; if the tracker is better, lower LearnSettings.position_wander (0.004 m)",
    ),
]


@pytest.mark.parametrize(("found", "sentence"), SENTENCES)
def test_sentences(found: str, sentence: str) -> None:
    assert found == sentence


def test_codes_of_plain_strings_are_empty_and_of_composed_messages_kept() -> None:
    in_run = of_recording.in_run(2, of_recording.no_motion())
    assert codes_of(["plain", in_run]) == ["", "no_motion"]
    assert in_run.values == {"run": 2}
    missed = of_execution.with_misses(of_execution.steps_used_up(3, 0.5, ""), [of_execution.does_not_stand()])
    assert (missed.code, missed.values["missed"]) == ("steps_used_up", ("does_not_stand",))
    assert isinstance(missed, Message)
