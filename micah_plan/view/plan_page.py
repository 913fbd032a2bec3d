"""The page of a plan: the object along the belief's mean with its uncertainty; or the reason of failure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.errors import InputError, located_in
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.planning.purposes import purpose_sentences
from micah_plan.quantities import count, percent, percent_interval, plain, quantity, with_spread
from micah_plan.recording.value import Recording
from micah_plan.task.body import corners
from micah_plan.task.contact_poses import settled_poses
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.task.start import start_mode
from micah_plan.view.camera import camera
from micah_plan.view.drawing import draw_copy, draw_shapes, link_shapes, object_size, shown_links
from micah_plan.view.executed import ExecutedRun, executed_runs, runs_of_recordings
from micah_plan.view.model_page import draw_ground_and_frame, draw_mode_joints, draw_object, ground_legend
from micah_plan.view.motion import (
    Keyframes,
    Moved,
    belief_ellipsoids,
    handle_path,
    keyframes,
    knot_times,
    mode_stretches,
    poses_over_time,
    shown_duration,
    step_times,
)
from micah_plan.view.page import Band, LegendEntry, ScenePage, Status, Timeline, render_scene
from micah_plan.view.palette import BELIEF, GOAL, INK, MUTED, START, mode_colors
from micah_plan.view.placement import chain_coordinates
from micah_plan.view.plan_charts import DrawnRun, plan_charts
from micah_plan.view.release import ReleaseMotion, goal_poses, joined_keyframes, release_facts, release_motion_of
from micah_plan.view.runs_on_page import draw_runs, first_runs, runs_badge, runs_details, runs_legend
from micah_plan.view.scene import DrawnScene, slug, transforms
from micah_plan.view.solids import straightened, tube
from micah_plan.view.surroundings import arm_facts, arm_legend, body_boxes, draw_arm, draw_bodies

IN_THE_WAY = "What stands in the way"
# Relative to the size of the object: thickness of paths, and the smallest radius that an ellipsoid is drawn with.
_PATH, _HELD_PATH, _FLOOR = 0.006, 0.014, 0.025
_BADGES: dict[str, tuple[str, Status]] = {
    "solved": ("SOLVED", "good"),
    "no_plan": ("NO PLAN", "bad"),
    "not_verified": ("NOT VERIFIED", "bad"),
}


def plan_page(
    plan: Plan,
    problem: Problem,
    *,
    title: str = "Plan",
    executed: Recording | Mapping[str, Recording] | None = None,
    failures: Mapping[int, str] | None = None,
) -> str:
    """The page of a plan as HTML text; without a trajectory it shows the reason, the start and the goal.

    Args:
        plan, problem: what is planned.
        title: of the page.
        executed: runs of the plan; or those of several recordings, by their names.
        failures: reasons of failed runs from the execution, by run; None: success is judged by their last rows.

    Raises:
        InputError: if the runs have other parts than the model, or there is no trajectory that they could follow.
    """
    problem = with_shown_points(problem)
    if plan.trajectory:
        plan = replace(plan, trajectory=plan.trajectory.of_first(problem.automaton.n))
    runs = _executed(plan, problem, executed, failures)
    badge, found = _BADGES[plan.outcome], plan.ranked_findings
    reason = f"{found[0].sentence}; {found[0].remedy}" if found and plan.outcome != "solved" else plan.reason
    panels = _Panels(
        title=title,
        kind="plan and its execution" if runs else "plan",
        badge=_badge_of_runs(plan, runs) if runs else badge,
        message=f"{badge[0].lower()}: {reason}" if runs else reason,
        facts=_facts(plan, problem),
        task=task_sentence(problem),
    )
    return _drawn(plan, problem, runs, panels)


def problem_page(problem: Problem, *, title: str = "Problem") -> str:
    """The page of an unsolved problem as HTML text: the object at the start and in the goal, and its surroundings."""
    message = "from the start, where the object is believed to be, to the goal"
    panels = _Panels(title, "problem", ("NOT SOLVED YET", "fair"), message, [], task_sentence(problem))
    return _drawn(Plan("no_plan", "not solved yet"), with_shown_points(problem), (), panels)


def _badge_of_runs(plan: Plan, runs: tuple[ExecutedRun, ...]) -> tuple[str, Status]:
    """The badge with the number of successful runs, preceded by the outcome of a plan that was not solved."""
    panels, status = runs_badge(runs)
    if plan.outcome == "solved":
        return panels, status
    outcome, status = _BADGES[plan.outcome]
    return f"{outcome}, {panels}", status


@dataclass(frozen=True)
class _Panels:
    """The panels beside the scene: see `ScenePage`."""

    title: str
    kind: str
    badge: tuple[str, Status]
    message: str
    facts: list[tuple[str, str]]
    task: str


def _drawn(plan: Plan, problem: Problem, runs: tuple[ExecutedRun, ...], panels: _Panels) -> str:
    """The page of a plan and its runs, or of start and goal where there is no trajectory."""
    automaton = problem.automaton
    scene, size = DrawnScene(), object_size(automaton)
    keys = keyframes(plan.trajectory) if plan.trajectory else _still(_start_mode(problem), np.array(problem.start.mean))
    goal = _goal(problem, keys)
    after = release_motion_of(plan, problem, keys, _end(plan.trajectory, runs)) if plan.trajectory else None
    keys, moved = _whole(problem, keys, after)
    draw_object(scene, automaton, keys, moved)
    draw_mode_joints(scene, automaton, keys, moved, size)
    _draw_state(scene, "start", problem, _start_mode(problem), np.array(problem.start.mean), START)
    _draw_state(scene, "goal", problem, goal.modes[0], goal.states[0], GOAL, goal_poses(problem, goal.states[0]))
    if plan.trajectory:
        _draw_belief(scene, problem, keys, size)
    if problem.hold is not None:
        _draw_changes(scene, problem, keys)
    if plan.trajectory and plan.arm:
        draw_arm(scene, problem, plan.arm, knot_times(plan.trajectory), keys.times, after)
    draw_bodies(scene, problem.scene)
    listed = draw_runs(scene, automaton, plan.trajectory, first_runs(runs), size) if plan.trajectory else []
    drawn = [DrawnRun(run.number, run.x, run.recording, run.color) for run in runs]
    spacing = draw_ground_and_frame(scene, size)
    parts = [link.child for _, link in shown_links(automaton)]
    points = np.concatenate([handle_path(automaton, frames, part) for frames in (keys, goal) for part in parts])
    colors = mode_colors(automaton)
    page = ScenePage(
        **vars(panels),
        camera=camera(scene, points, body_boxes(problem.scene)),
        chips=[(name, colors.get(name, INK)) for name in plan.mode_sequence],
        reasons=[(mode, colors.get(mode, INK), sentence) for mode, sentence in purpose_sentences(plan)],
        legend=[*(runs_legend(runs) if runs else []), *_legend(plan, problem, size, spacing)],
        details=[*(runs_details(runs) if runs else []), *_details(plan, problem)],
        open_details=(IN_THE_WAY,) if plan.findings[1:] else (),  # the first is the page's message
        timeline=_timeline(plan.trajectory, problem, runs, after) if plan.trajectory else Timeline(),
        hidden=["spread"],
        charts=plan_charts(plan, pre_release_problem(problem), drawn),
        runs=listed,
        shows_all_runs=len({run.recording for run in runs}) > 1,
        is_tinted=plan.trajectory is not None,
    )
    return render_scene(page, scene)


def _whole(problem: Problem, keys: Keyframes, after: ReleaseMotion | None) -> tuple[Keyframes, Moved]:
    """Keyframes of a plan and its release, with the poses of the parts."""
    automaton = problem.automaton
    moved = poses_over_time(automaton, keys) if problem.hold is None else settled_over_time(problem, keys)
    if after is None:
        return keys, moved
    return joined_keyframes(keys, after), {
        name: transforms([*poses, *after.moved[name]]) for name, poses in moved.items()
    }


def _executed(
    plan: Plan,
    problem: Problem,
    executed: Recording | Mapping[str, Recording] | None,
    failures: Mapping[int, str] | None,
) -> tuple[ExecutedRun, ...]:
    if executed is None:
        return ()
    if plan.trajectory is None:
        raise InputError("the plan has no trajectory that runs could follow", remedy="show it without runs")
    recordings = {"": executed} if isinstance(executed, Recording) else executed
    done, trajectory = pre_release_problem(problem), plan.trajectory
    runs = dict[str, tuple[ExecutedRun, ...]]()
    for name, one in recordings.items():
        with located_in(name) if name else nullcontext():
            runs[name] = executed_runs(done, trajectory, one, failures)
    return runs_of_recordings(runs)


def _start_mode(problem: Problem) -> str:
    """The mode that the problem starts in; the first for a start that is in none."""
    return start_mode(problem.automaton, problem.start)[0] or problem.automaton.modes[0].name


def _still(mode: str, x: Floats) -> Keyframes:
    return Keyframes(np.zeros(1), (mode,), x[None])


def _goal(problem: Problem, keys: Keyframes) -> Keyframes:
    """A state in the middle of the goal set, the free coordinates as at the end, and a mode to draw it in."""
    x = keys.states[-1].copy()
    for index, value, _ in problem.goal.target:
        x[index] = value
    inside = [q for q in problem.automaton.modes_at(x, 1e-9) if q in problem.goal.modes or not problem.goal.modes]
    return _still((*inside, *problem.goal.modes, keys.modes[-1])[0], x)


def _draw_state(
    scene: DrawnScene, layer: str, problem: Problem, mode: str, x: Floats, color: str, poses: Moved | None = None
) -> None:
    """A pale copy of the moving parts at one state, or at poses (single)."""
    poses = settled_poses(problem, mode, x) if poses is None else poses
    for number, link in shown_links(problem.automaton):
        shapes = link_shapes(problem.automaton, number)
        draw_copy(scene, f"{layer}/{slug(link.child, number)}", shapes, poses[link.child], color, 0.28)


def _draw_belief(scene: DrawnScene, problem: Problem, keys: Keyframes, size: float) -> None:
    """The ellipsoid of each part's handle along the plan, the path of its centre, and pale copies k σ off the mean."""
    automaton = problem.automaton
    colors = mode_colors(automaton)
    thickness = (_PATH if problem.hold is None else _HELD_PATH) * size
    for number, link in shown_links(automaton):
        freedoms = len(chain_coordinates(automaton, link.child))
        factor = float(np.sqrt(chdtri(freedoms, 1.0 - problem.settings.confidence)))
        poses, radii = belief_ellipsoids(automaton, keys, link.child, factor, _FLOOR * size)
        path = f"belief/{slug(link.child, number)}"
        scene.unit_sphere(path, BELIEF, opacity=0.65)
        scene.animate(path, keys.times, poses, scales=radii)
        centers = poses.translation
        scene.reserve(centers)
        if problem.hold is not None and link.child != problem.hold.grip.held.name:
            continue  # the mean of what swings is no path that anything takes
        for order, (first, last) in enumerate(mode_stretches(keys.modes)):
            ends = straightened(centers[first : last + 1])
            scene.mesh(f"path/{slug(link.child, number)}/{order}", tube(ends, thickness), colors[keys.modes[first]])
    spread = problem.settings.sigmas * np.sqrt((keys.factors**2).sum(axis=2))
    for side, sign in (("ahead", 1.0), ("behind", -1.0)):
        moved = poses_over_time(automaton, keys, sign * spread)
        for number, link in shown_links(automaton):
            path = f"spread/{side}/{slug(link.child, number)}"
            draw_shapes(scene, path, link_shapes(automaton, number), color=BELIEF, opacity=0.16)
            scene.animate(path, keys.times, moved[link.child])


def _draw_changes(scene: DrawnScene, problem: Problem, keys: Keyframes) -> None:
    """Pale copies of a held object where it enters a mode, in the mode's colour."""
    colors = mode_colors(problem.automaton)
    for number, (first, _) in enumerate(mode_stretches(keys.modes)[1:]):
        mode = keys.modes[first]
        _draw_state(scene, f"changes/{number}", problem, mode, keys.states[first], colors[mode])


def _legend(plan: Plan, problem: Problem, size: float, spacing: float) -> list[LegendEntry]:
    confidence, sigmas = percent(problem.settings.confidence), plain(problem.settings.sigmas)
    entries = []
    if plan.trajectory:
        floor = quantity(_FLOOR * size, "m")
        caption = f"belief: {confidence} ellipsoid of the handle, seen through the object (radii at least {floor})"
        entries += [
            LegendEntry(BELIEF, caption, "belief", "dot", "b", "belief"),
            LegendEntry(BELIEF, f"object at the mean ± {sigmas} σ", "spread", "area", "s", "spread"),
            LegendEntry(INK, "planned path of the handle, by mode", "path", "line"),
        ]
        if problem.hold is not None:
            entries.append(LegendEntry(MUTED, "object where it enters a mode", "changes"))
    entries += [LegendEntry(START, "start", "start"), LegendEntry(GOAL, "goal", "goal")]
    colors = mode_colors(problem.automaton)
    entries.append(LegendEntry(INK, "joint axes, and paths by mode:", "joints", "line"))
    shown = [name for name in problem.automaton.mode_names if name != COLLIDED or COLLIDED in plan.mode_sequence]
    entries += [LegendEntry(colors[name], f"mode {name}", shape="line") for name in shown]
    return [*entries, *arm_legend(plan, problem), *ground_legend(spacing)]


def task_sentence(problem: Problem) -> str:
    """The task in one sentence: targets, modes and confidence."""
    ways = [_target_text(problem, *target) for target in problem.goal.target]
    modes = pre_release_problem(problem).goal.modes
    if modes and len(modes) < len(problem.automaton.modes):
        ways.append(f"ending in mode {' or '.join(modes)}")
    return f"{', '.join(ways)}, with a confidence of {percent(problem.settings.confidence)}"


def _target_text(problem: Problem, index: int, value: float, tolerance: float) -> str:
    """Start and target of one coordinate."""
    coordinate, start = problem.automaton.coordinates[index], problem.start.mean[index]
    goal = with_spread(value, tolerance, coordinate.unit, degrees=False)
    if abs(start - value) <= tolerance:
        return f"{coordinate.name} stays at {goal}"
    return f"{coordinate.name} from {quantity(start, coordinate.unit, degrees=False)} to {goal}"


def _facts(plan: Plan, problem: Problem) -> list[tuple[str, str]]:
    facts = list[tuple[str, str]]()
    if plan.goal_error is not None:
        facts.append(("Distance to target", quantity(plan.goal_error, problem.goal_unit)))
    if plan.goal_std is not None:
        facts.append(("σ at the end", quantity(plan.goal_std, problem.goal_unit)))
    if plan.success_probability is not None:
        runs = count(plan.verification_trials, "simulated run")
        facts.append((f"Success in {runs}", percent(plan.success_probability)))
        if plan.success_interval is not None:
            facts.append(("95 % interval of success", percent_interval(*plan.success_interval)))
    if plan.cost is not None:
        facts.append(("Cost", plain(plan.cost)))
    if plan.trajectory is not None:
        facts.append(("Steps", f"{step_times(plan.trajectory)[-1]}"))
    return [*facts, *release_facts(plan, problem), *arm_facts(plan), ("Seed", str(plan.seed))]


def _details(plan: Plan, problem: Problem) -> list[tuple[str, list[str]]]:
    tried = []
    for candidate in plan.candidates:
        cost = "failed" if candidate.cost is None else f"cost {plain(candidate.cost)}"
        tried.append(f"{' → '.join(candidate.modes)}: {cost}. {candidate.message}")
    details = [("Mode sequences tried", tried)] if tried else []
    findings = [f"{finding.sentence}. Remedy: {finding.remedy}" for finding in plan.findings]
    if findings:
        title = "Limits kept only in part" if plan.outcome == "solved" else IN_THE_WAY
        details.insert(0, (title, findings))
    start = [
        f"{c.name} = {with_spread(mean, std, c.unit)} (1 σ)"
        for c, mean, std in zip(problem.automaton.coordinates, problem.start.mean, problem.start.std, strict=True)
    ]
    return [*details, ("Start belief", [*start, f"mode {_start_mode(problem)}"])]


def _end(trajectory: Trajectory, runs: Sequence[ExecutedRun]) -> float:
    """Duration of a plan and of longer runs [s]."""
    return shown_duration(trajectory, max((len(run.x) - 1.0 for run in runs), default=0.0))


def _timeline(
    trajectory: Trajectory, problem: Problem, runs: Sequence[ExecutedRun], after: ReleaseMotion | None
) -> Timeline:
    automaton, period = problem.automaton, parameters_of(problem).control_period
    steps, times = step_times(trajectory), knot_times(trajectory)
    end = _end(trajectory, runs)
    stds = np.sqrt((trajectory.factors**2).sum(axis=2))
    readouts = []
    for k, time in enumerate(times):
        passed = quantity(float(steps[k] * period), "s")
        lines = [f"step {steps[k]} of {steps[-1]} ({passed}), mode {trajectory.modes[k]}"]
        for i, c in enumerate(automaton.coordinates):
            mean, std = float(trajectory.means[k, i]), float(stds[k, i])
            lines.append(f"{c.name} = {with_spread(mean, std, c.unit, degrees=False)} (1 σ)")
        readouts.append((float(time), tuple(lines)))
    colors, entered = mode_colors(automaton), [first for first, _ in mode_stretches(trajectory.modes)]
    bands = [
        Band(float(times[first]), float(until), colors[trajectory.modes[first]], trajectory.modes[first])
        for first, until in zip(entered, [*times[entered[1:]], end], strict=True)
    ]
    if after is not None:
        bands += after.bands
        panels = ("lowered until contact is felt", "gripper opened, the object turns until it lies", "hand withdraws")
        readouts += [(band.start, (words,)) for band, words in zip(after.bands, panels, strict=True)]
        end = bands[-1].end
    return Timeline(end, tuple(bands), tuple(readouts))


def settled_over_time(problem: Problem, keys: Keyframes) -> Moved:
    """(k,) poses of every part, as contacts leave them."""
    single = [settled_poses(problem, mode, x) for mode, x in zip(keys.modes, keys.states, strict=True)]
    return {name: transforms([poses[name] for poses in single]) for name in single[0]}


def with_shown_points(problem: Problem) -> Problem:
    """The problem with handles for a held object: the grasped point, and the far end of the moving part.

    The belief of the joint is drawn at the far end, that of the hand at the hand. Other problems are unchanged.
    """
    if problem.hold is None:
        return problem
    grip = problem.hold.grip
    points = np.concatenate([corners(shape) for shape in grip.moving.shapes])
    lower, upper = points.min(axis=0), points.max(axis=0)
    end = (float(upper[0]), float(lower[1] + upper[1]) / 2, float(lower[2] + upper[2]) / 2)
    handles = {grip.held.name: grip.point, grip.moving.name: end}
    parts = tuple(replace(part, handle=handles.get(part.name, part.handle)) for part in problem.automaton.parts)
    return replace(problem, automaton=replace(problem.automaton, parts=parts))
