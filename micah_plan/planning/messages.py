"""Sentences of plans and of failed plans: findings, remedies, purposes of modes."""

from __future__ import annotations

from collections.abc import Sequence

from micah_plan.message import message
from micah_plan.quantities import count, percent, plain, quantity

CHANGE_GOAL_OR_START = "change the goal or the start"
CHANGE_GOAL_OR_ADD_TRANSITION = "change the goal, or add the missing transition to the model"
NAME_THE_MODE = "name the mode the object is in"
MOVE_START_OR_OBSTACLE = "move the start or the obstacle"
MOVE_GOAL_OR_OBSTACLE = "move the goal or the obstacle"
MOVE_GOAL_INTO_RANGE = "move the goal into one of these ranges"
MOVE_GOAL_OR_START_AWAY = "move the goal or the start away from it"
RELAX_CONSTRAINT = "relax it"
MAKE_ROOM_OR_CHANGE_MODE = "make room there, or let the object change its mode first"
CORRECT_RESET = "correct the reset or the invariant in the model"
CORRECT_GUARD = "correct the guard, the invariant or the inputs of the mode"
CORRECT_INPUTS = "correct the inputs that the model admits"
MORE_ROOM = "make more room (no confidence above 0.5 is enough)"
ROOM_AT_TRANSITION = "give the modes more room at that transition"
RAISE_TIME_LIMIT = "raise time_limit_s"
RAISE_SOLVE_TIME_LIMIT = "raise solve_time_limit_s"
LOWER_CONFIDENCE = "lower `confidence`"
OTHER_SEED = "try another seed"
MOVE_GRASP = "move the grasp"
MOVE_ROOT = "move the robot's root"
OTHER_GRASP = "choose another grasp, or move the goal or the obstacle"
MEASURE_SUPPORT = "widen the tolerance of 'z', or measure the support"
WIDEN_GOAL = "widen the goal's tolerance"
UNUSABLE_GUESS = "the initial guess of the optimisation cannot be used"
COST_NOT_A_NUMBER = "the cost is not a number"
SOLVER_STATUS = {
    "Solve_Succeeded": "locally optimal",
    "Solved_To_Acceptable_Level": "locally optimal to a loose tolerance",
    "Feasible_Point_Found": "feasible",
    "Infeasible_Problem_Detected": "near the path that was tried, no inputs satisfy all constraints",
    "Restoration_Failed": "no point that satisfies the constraints was found",
    "Maximum_Iterations_Exceeded": "stopped at the largest number of iterations",
    "Maximum_WallTime_Exceeded": "stopped at the time limit (time_limit_s)",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit (time_limit_s)",
    "Search_Direction_Becomes_Too_Small": "no further progress was possible",
    "Diverging_Iterates": "the iterates diverged: the cost has no lower limit",
    "Invalid_Number_Detected": "a constraint or the cost became not a number",
    "Not_Enough_Degrees_Of_Freedom": "there are more equality constraints than variables",
}
"""How an optimisation ended, by the solver's status."""
ARM_CANNOT_FOLLOW = "the arm cannot follow the plan: "
LOWER = "lower the object to release it"
WITHDRAW = "withdraw"
WITHOUT_FINDINGS = "the file has no details, since an older version wrote it: solve the problem again"


def sequence(modes: Sequence[str]) -> str:
    """A mode sequence as text."""
    return " -> ".join(modes)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def within_range(coordinate: str) -> str:
    """The remedy for a start outside a range."""
    return f"start {coordinate} within the range"


def start_at(coordinate: str) -> str:
    """The same, with the number to follow."""
    return f"start {coordinate} at"


def allow_contact(mode: str) -> str:
    """The remedy where a mode of contact is to be avoided."""
    return f"allow contact with '{mode}'"


def relax_by(what: str, amount: float, unit: str) -> str:
    """The remedy for a missed constraint."""
    return f"relax {what} by {quantity(amount, unit)}"


def relax_for_share(amount: float, unit: str, share: float) -> str:
    """The remedy for a constraint that too many roll-outs violate."""
    return f"relax it by {quantity(amount, unit)}, which {percent(share)} of them satisfy"


def widen_tolerance(coordinate: str) -> str:
    """The remedy for a missed target."""
    return f"widen the tolerance of '{coordinate}'"


def localise(mode: str, coordinate: str) -> str:
    """The remedy where another mode measures a coordinate better."""
    return f"let the plan return through '{mode}', where '{coordinate}' is measured better: raise `revisits`"


def none_helped(tried: Sequence[str]) -> str:
    """The remedy where trials of all others failed."""
    return f"change the task or the model (tried without success: {', '.join(tried)})"


def untested(remedy: str) -> str:
    """A remedy for whose trial no budget was left."""
    return f"{remedy} (not tried)"


def trying(remedy: str) -> str:
    """Progress: a remedy is being tried."""
    return f"no plan; trying to {remedy}"


# Start and goal


@message
def start_misses_mode(sentence: str, mode: str, amount: float, unit: str) -> str:
    """A start outside a mode, with the amount."""
    return f"{sentence}: it misses mode '{mode}' by {quantity(amount, unit)}"


@message
def goal_outside_range(name: str, value: float, tolerance: float, unit: str, ranges: str, missing: float) -> str:
    """A target outside the ranges of all modes that the goal admits."""
    return (
        f"the goal {name} = {value:g} ± {tolerance:g} {unit} is outside the range {ranges} {unit} by "
        f"{quantity(missing, unit)}"
    )


@message
def goal_in_no_mode(wanted: str, of_goal: bool, ranges: Sequence[str]) -> str:
    """No mode admits all targets together."""
    among = "goal's modes" if of_goal else "modes"
    return f"the goal {wanted} is in the range of none of the {among} ({'; '.join(ranges)})"


@message
def no_transition_to_goal(start: str, goals: Sequence[str]) -> str:
    """The graph of modes does not connect start and goal."""
    return f"no transitions lead from the start's mode '{start}' to a mode that contains the goal ({_listed(goals)})"


@message
def start_in_obstacle(guard: str, edge: str, depth: float, unit: str) -> str:
    """The start is where another transition happens."""
    return f"the start is inside '{guard}' ('{edge}'), {quantity(depth, unit)} deep"


@message
def goal_in_obstacle(guards: Sequence[tuple[str, str]]) -> str:
    """All of the goal is where other transitions, (guard, edge), happen."""
    names = [f"'{guard}' ('{edge}')" for guard, edge in guards]
    return f"the goal is inside {' and '.join(names)}"


# Search


@message
def coordinate_not_moved(name: str, unit: str, start: float, goal: tuple[float, float], is_moved: bool) -> str:
    """A coordinate that no mode moves to the goal (value, tolerance), though a mode apart from it may move it."""
    which = "leads on to the goal" if is_moved else "can be reached"
    return (
        f"'{name}' starts at {start:g} {unit} and the goal is {goal[0]:g} ± {goal[1]:g} {unit}, but no mode that "
        f"{which} moves it"
    )


@message
def search_limit_reached(programmes: int) -> str:
    """The search ended at its limit."""
    return f"the search stopped after {programmes:,} linear programmes, before a mode sequence led to the goal"


@message
def constraint_in_the_way(names: Sequence[str]) -> str:
    """Constraints and guards, without any one of which start and goal would be connected."""
    first, *others = names
    alternatives = f" (or without {', '.join(map(repr, others))})" if others else ""
    return f"the reachable modes lead to the goal only without '{first}'{alternatives}"


@message
def not_connected(states: int) -> str:
    """The roadmaps, of so many states per mode, do not connect start and goal."""
    return (
        f"the roadmaps ({states} states per mode) do not connect the start to the goal: guards of other transitions "
        "block the way, or there are too few states"
    )


@message
def too_few_revisits(revisits: int) -> str:
    """Modes have to be entered more often."""
    times = "once" if revisits == 0 else f"{1 + revisits} times"
    return f"no inputs lead to the goal if each mode is entered at most {times}"


@message
def inputs_keep_coordinates(kept: Sequence[tuple[str, Sequence[str]]], is_cut: bool) -> str:
    """Functions of the state that the inputs of modes do not change keep the goal unreachable."""
    listed = [f"'{mode}' keeps {' and '.join(words)}" for mode, words in kept]
    return (
        "no inputs lead to the goal, even without obstacles: what the inputs of a mode cannot change stays as it was "
        f"on entry ({', '.join([*listed, *['...'] * is_cut])})"
    )


@message
def guard_unreachable(edge: str, guard: Sequence[str], mode: str) -> str:
    """A guard on inputs above their limits."""
    return f"the guard of '{edge}' ({_listed(guard)}) holds nowhere in mode '{mode}' with inputs up to max_step"


@message
def guard_empty(edge: str, guard: Sequence[str], mode: str) -> str:
    """A guard that no state and input satisfies."""
    return f"the guard of '{edge}' ({_listed(guard)}) holds nowhere in mode '{mode}', whatever max_step is"


@message
def reset_outside_mode(edge: str, mode: str) -> str:
    """A reset to states outside the next mode."""
    return f"the reset of '{edge}' leads out of the invariant of mode '{mode}'"


def without_detour() -> str:
    """State of the search at the time limit."""
    return "no detour was searched"


def sequence_untried(modes: Sequence[str], steps: int) -> str:
    """State of the optimisation at the time limit, before a sequence, or before more than `steps` (-1: none)."""
    return f"{sequence(modes)} was not tried{' with more knots' if steps >= 0 else ''}"


def sequence_at(modes: Sequence[str], steps: int) -> str:
    """State of the optimisation at the time limit, in a sequence."""
    return f"{sequence(modes)} was at {count(steps, 'step')}"


# Optimisation


@message
def too_few_knots(needed: int, allowed: int) -> str:
    """A path longer than the settings allow."""
    return f"the path needs at least {needed} knots at the largest step, more than max_knots = {allowed}"


@message
def optimisation_failed(status: str) -> str:
    """An optimisation that failed without a violated constraint."""
    return f"the optimisation failed: {status}"


@message
def not_a_number(constraint: str) -> str:
    """A constraint that has no value."""
    return f"{constraint} is not a number"


@message
def constraint_missed(constraint: str, amount: float, unit: str) -> str:
    """A constraint that does not hold."""
    return f"{constraint} is missed by {quantity(amount, unit)}"


def at_knot(sentence: str, knot: int, mode: str) -> str:
    """A sentence with its place in the plan."""
    return f"{sentence} at knot {knot} in mode '{mode}'"


def holds_in_part(constraint: str, confidence: float, knot: int, mode: str) -> str:
    """A boundary that a plan keeps with less than its confidence."""
    return f"{constraint} holds with less than {percent(confidence)} around knot {knot} in mode '{mode}'"


@message
def no_room_to_reverse(name: str, modes: tuple[str, str], room: float, need: float, unit: str, share: float) -> str:
    """A boundary that one step must cross, since inputs act the other way behind it; modes before and behind."""
    where = f"{quantity(abs(room), unit)} {'before' if room >= 0 else 'behind'} it"
    return (
        f"behind {name} the same input moves the other way ('{modes[0]}' and '{modes[1]}'), so a single step must "
        f"cross it: the step starts {where}, but {_need(need, unit, share)}"
    )


@message
def corridor_too_narrow(name: str, room: float, need: float, unit: str, share: float) -> str:
    """Two boundaries closer to each other than the belief needs."""
    return f"the corridor at {name} is {quantity(room, unit)} wide, but {_need(need, unit, share)}"


@message
def guard_not_entered(name: str, room: float, need: float, unit: str) -> str:
    """A mean that does not get far enough into a guard."""
    if room >= 0.0:
        return f"the mean gets {quantity(room, unit)} past {name}, but the transition needs {quantity(need, unit)}"
    return (
        f"the mean stops {quantity(-room, unit)} before {name}, but the transition needs {quantity(need, unit)} past it"
    )


@message
def margin_too_small(name: str, room: float, need: float, unit: str, share: float) -> str:
    """A constraint on the path that the mean satisfies by too little."""
    return f"the mean satisfies {name} by {quantity(room, unit)}, but {_need(need, unit, share)}"


@message
def path_too_close(name: str, room: float, need: float, unit: str, share: float) -> str:
    """A path too close to a boundary."""
    return f"the path is {quantity(room, unit)} from {name}, but {_need(need, unit, share)}"


def _need(need: float, unit: str, share: float) -> str:
    return f"the belief needs {quantity(need, unit)} at {percent(share)}"


# Verification


def found(modes: Sequence[str]) -> str:
    """Beginning of the reason of a plan that was found and refused."""
    return f"found {sequence(modes)}, but "


@message
def too_many_trials(needed: int, confidence: float, most: int) -> str:
    """A confidence that takes too many roll-outs to show."""
    return f"it takes {needed:,} roll-outs to show a confidence of {percent(confidence)}, more than {most:,}"


@message
def too_few_succeed(successes: int, trials: int, confidence: float) -> str:
    """The roll-outs succeed less often than the confidence."""
    return (
        f"{successes} of {trials} roll-outs ({percent(successes / trials, 0)}) end in the goal, fewer than the "
        f"confidence of {percent(confidence)} requires"
    )


@message
def leaves_mode_sequence(knot: int, planned: str, visited: str) -> str:
    """A noise-free replay leaves the planned modes."""
    return (
        f"even without noise the plan is in mode '{visited}' at knot {knot}, not in '{planned}': other transitions "
        "happen on the way"
    )


@message
def ends_in_other_mode(share: float, modes: Sequence[str], commonest: str) -> str:
    """Roll-outs that end in modes without the goal."""
    return (
        f"{percent(share, 0)} of the roll-outs end in another mode than {' or '.join(modes)}, most of them in "
        f"'{commonest}'"
    )


@message
def misses_goal(
    share: float, coordinate: str, mode: str, confidence: float, need: float, tolerance: float, unit: str
) -> str:
    """Roll-outs that end outside the tolerance of a coordinate, most of them in a mode (empty: the plan's last)."""
    where = f", most of them in mode '{mode}'" if mode else ""
    return (
        f"{percent(share, 0)} of the roll-outs end outside the goal for '{coordinate}'{where}: {percent(confidence)} "
        f"are within {quantity(need, unit)}, its tolerance is {quantity(tolerance, unit)}"
    )


@message
def misses_goal_jointly(share: float) -> str:
    """Roll-outs that miss some target, though each target alone is met often enough."""
    return f"{percent(share, 0)} of the roll-outs end outside the goal, where all targets must be met together"


@message
def breaks_constraint(share: float, name: str, amount: float | None, unit: str) -> str:
    """Roll-outs that violate a constraint on the path, by up to an amount if it is known."""
    by = "" if amount is None else f", by up to {quantity(amount, unit)}"
    return f"{percent(share, 0)} of the roll-outs violate '{name}'{by}"


@message
def constraint_violated(name: str, amount: float, unit: str) -> str:
    """An execution that violated a constraint on the path."""
    return f"'{name}' was violated by {quantity(amount, unit)}"


def roll_outs_at(step: int, steps: int) -> str:
    """State of the verification at the time limit."""
    return f"roll-outs were at step {step} of {steps}"


@message
def no_time_for_more_room(limit_s: float) -> str:
    """Planning with a higher confidence was cut off."""
    return f"the time limit of {limit_s:g} s (solve_time_limit_s) was reached before planning with more room"


def planned_again(times: int, confidence: float, why: str) -> str:
    """End of the reason of a plan that was made with a higher confidence."""
    often = "once" if times == 1 else f"{times} times"
    return f"; planned again {often}, at last with a confidence of {percent(confidence)}{f': {why}' if why else ''}"


# Arm and release


@message
def arm_cannot(task: str, failure: str) -> str:
    """A release that the arm cannot do."""
    return f"the arm cannot {task}: {failure} of that path"


@message
def grasp_meets_obstacle(pair: tuple[str, str], is_release: bool) -> str:
    """Two solids that collide for every hand pose in the goal."""
    where = "the hand sets the object down" if is_release else "the hand is"
    return f"wherever in the goal {where}, {pair[0]} meets {pair[1]}: this grasp does not allow the goal"


def fails_closer(failure: str) -> str:
    """End of the reason where the arm failed before it was kept away from that place."""
    return f"; closer to the goal the arm fails: {failure}"


@message
def support_uncertain(tolerance: float, probability: float, std: float) -> str:
    """An object released on a support of uncertain height [m]."""
    return (
        f"after release the object rests within {quantity(tolerance, 'm')} of its height with {percent(probability)}: "
        f"the support's height is known to {quantity(std, 'm')} (1 σ)"
    )


@message
def rotating_parts_unchecked(parts: Sequence[str]) -> str:
    """A warning: plans do not avoid the scene for parts that rotate."""
    return f"parts that rotate are not kept clear of the scene: {_listed(parts)}; look at the page"


# Whole plans


def no_sequence_optimised(modes: Sequence[str]) -> str:
    """Beginning of the reason where all optimisations failed; the first sequence's failure follows."""
    return f"no mode sequence could be optimised; {sequence(modes)}: "


def chosen(rank: int, sequences: int, status: str) -> str:
    """How a plan was chosen: rank by cost among so many sequences."""
    which = "the cheapest" if rank == 1 else f"number {rank} by cost"
    among = "the only mode sequence found" if sequences == 1 else f"{which} of {sequences} mode sequences"
    return f", {among}: {status}"


def solved_through(modes: Sequence[str], share: float | None) -> str:
    """Summary of a solved plan, with the share of roll-outs that succeed if they were made."""
    verified = "" if share is None else f", {percent(share)} of the roll-outs succeed"
    return f"solved through {sequence(modes)}{verified}"


def failed_at(is_found: bool, level: str | None, reason: str) -> str:
    """Summary of a failed plan."""
    failed = "a plan was found but not verified" if is_found else "there is no plan"
    return f"{failed}: {reason if level is None else f'it fails at the level of {level}'}"


def candidate(modes: Sequence[str], cost: float | None, status: str) -> str:
    """A candidate's result."""
    return f"tried {sequence(modes)}: {'no plan' if cost is None else f'cost {plain(cost)}'}, {status}"


# Purposes of modes


@message
def only_mode_of_goal() -> str:
    """The goal is in this mode alone."""
    return "the goal is in no other mode"


@message
def no_path_without(why: str) -> str:
    """Without the mode there is no path."""
    return f"without it the search finds no path: {why}"


@message
def costs_more_without(modes: Sequence[str], steps: float, instead: float | None) -> str:
    """Without the mode the search expects a higher cost [steps]."""
    own = "" if instead is None else f" instead of {plain(instead)}"
    return f"the path without it, {sequence(modes)}, was expected to cost {plain(steps)} steps{own}"


@message
def no_plan_without(modes: Sequence[str]) -> str:
    """The optimisation without the mode failed."""
    return f"the path without it, {sequence(modes)}, was tried and gives no plan"


@message
def plan_costs_more_without(modes: Sequence[str], cost: float, own: float) -> str:
    """The plan without the mode costs more."""
    return f"without it, through {sequence(modes)}, a plan costs {plain(cost)} instead of {plain(own)}"


@message
def plan_fails_without(modes: Sequence[str], cost: float) -> str:
    """The roll-outs of the plan without the mode fail."""
    return f"without it, through {sequence(modes)}, a plan costs {plain(cost)}, but its roll-outs fail"


@message
def same_reason(mode: str) -> str:
    """The purpose of another mode."""
    return f"for the same reason as {mode}"
