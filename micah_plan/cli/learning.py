"""`micah-plan learn`: from a recording to a model.

**`micah-plan explore`.** From the first touch to a model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from micah_plan.api.formatting import SUREST
from micah_plan.cli.console import (
    NO_RESULT,
    JsonFlag,
    OutputPath,
    Seed,
    out,
    print_files,
    print_lines,
    print_summary,
    print_warnings,
    progress_bar,
    table,
    title_of,
)
from micah_plan.cli.conventions import Columns, Frame, Order, PartName, Rate, Robot, Said, Tool, Topics, Units, Up
from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import FIGURE, MODEL, PAGE, Output, check_outputs
from micah_plan.quantities import count, duration, in_degrees, percent, plain, quantity, way
from micah_plan.task.plants import DEFAULT_PLANT

if TYPE_CHECKING:
    from micah_plan.api.stages import Learned
    from micah_plan.automaton.graph import ActionChannel, Deviation, KinematicEdge, Segment
    from micah_plan.automaton.joint import Joint
    from micah_plan.explore.run import Exploration
    from micah_plan.learn.settings import LearnSettings


_COLUMNS = ("joint", "rows", "configuration", "axis", "radius", "P(kind)", "start row\n(95 %)")
_WIDE = 108  # columns, with which a row of the table fits on one line
_NARROW = ("joint", "rows", "P(kind)")


def learn(
    recording: Annotated[Path, typer.Argument(help="Recording (CSV, TUM text, NPZ, Parquet or ROS logs).")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write: a model (YAML).")] = None,
    method: Annotated[
        Literal["act-champ", "champ"], typer.Option(help="Score segments with or without the actions.")
    ] = "act-champ",
    parts: Annotated[
        Path | None, typer.Option(help="Shapes and handles of the parts (YAML), added to the model.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(metavar="PART", help="Tracked part on which the object stands; the model is in its frame."),
    ] = None,
    columns: Columns = None,
    units: Units = None,
    rate: Rate = None,
    up: Up = None,
    quaternion: Order = None,
    name: PartName = None,
    topic: Topics = None,
    frame: Frame = None,
    robot: Robot = None,
    tool: Tool = None,
    list_topics: Annotated[bool, typer.Option("--list-topics", help="Only say what a ROS log has.")] = False,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A setting of learning, as kinds=rigid,screw; repeatable."),
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the segmented track as PNG.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the segmented track as a page.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Learn a hybrid automaton from a recording and save it as YAML; exit code 1 if no single joint fits some rows."""
    if list_topics:
        _list_topics(recording, as_json)
        raise typer.Exit
    if output is None:
        raise InputError("missing option '-o' / '--output'", remedy="see micah-plan learn --help")
    said = Said(columns, units, rate, up, quaternion, name, topic, frame, robot, tool)
    from micah_plan.documents.parts import load_parts
    from micah_plan.files import replace_files

    asked = Output("-o", output, MODEL), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    check_outputs((recording, parts), asked)
    shapes, settings = () if parts is None else load_parts(parts), _settings(setting or ())
    with progress_bar(as_json) as progress:
        options = {"method": method, "seed": seed, "parts": shapes, "settings": settings, "base": base}
        found = _learned_from(recording, said, progress=progress, **options)
    print_warnings(found.warnings)
    written = (output if found.automaton is not None else None, figure, html)
    replace_files(_contents(found, *written, title=recording.stem))
    print_summary(as_json, learned(found, seed), lambda: _print_learned(found, written))
    if found.automaton is None:
        raise typer.Exit(NO_RESULT)


def _learned_from(recording: Path, said: Said, **options: Any) -> Learned:
    """What `stages.learn` finds in a file, whose units must be clear."""
    from micah_plan.api import stages
    from micah_plan.learn.settings import FEWEST_ROWS
    from micah_plan.recording.suspicion import require_conventions

    measured = stages.read(recording, minimum_rows=FEWEST_ROWS, conventions=said.conventions())
    with located_in(recording):
        require_conventions(measured)
        return stages.learn(measured, **options)


def learned(result: Learned, seed: int) -> dict[str, Any]:
    """Keys of `learn`: segments, changepoints and actions of the part, seconds, seed.

    For several parts the first three are in `edges`, and `tree_probability` is that of this tree of parts.

    What was not estimated is null.
    """
    edges = [{"parent": edge.parent, "child": edge.child, **_edge(edge)} for edge in result.graph.edges]
    tree = {"edges": edges, "tree_probability": result.graph.probability}
    summary = tree if len(edges) > 1 else _edge(result.graph.edges[0])
    modes = () if result.automaton is None else result.automaton.mode_names
    outcome = {"modes": modes, "reason": result.reason, "warnings": result.warnings}
    return {**summary, **outcome, "seconds": result.seconds, "seed": seed}


def _settings(texts: Sequence[str]) -> LearnSettings:
    """The settings of learning, with those changed that are given as NAME=VALUE.

    Raises:
        InputError: for a name that is none, and a value that is none of it.
    """
    from micah_plan.api.inputs import learn_settings
    from micah_plan.learn.settings import LearnSettings

    changes: dict[str, Any] = {}
    for text in texts:
        name, equals, value = (piece.strip() for piece in text.partition("="))
        if not (name and equals and value) or name in changes:
            problem = f"expected NAME=VALUE, each once, found {shown(text)}"
            raise InputError(problem, source="--set", remedy="e.g. --set position_wander=0.001")
        changes[name] = _setting(name, value, getattr(LearnSettings(), name, None))
    return learn_settings(None, changes)


def _setting(name: str, text: str, default: Any) -> Any:
    """The value of a setting, of the type that its default has.

    Raises:
        InputError: if the text is none.
    """
    if isinstance(default, tuple):
        return tuple(piece.strip() for piece in text.split(","))
    from micah_plan.recording.text import is_number

    expected: str
    probability: float | None
    if isinstance(default, bool):
        expected, probability = "true or false", {"true": True, "false": False}.get(text.lower())
    elif isinstance(default, int):
        expected, probability = "a whole number", int(text) if text.isdecimal() and len(text) < 10 else None
    else:
        expected, probability = "a number", float(text) if is_number(text) else None
        if default is None and text.lower() == "none":
            return None
    if probability is None:
        problem = f"expected {expected} for {name}, found {shown(text)}"
        raise InputError(problem, source="--set", remedy="e.g. --set position_wander=0.001")
    return probability


def _contents(
    learned: Learned, output: Path | None, figure: Path | None, html: Path | None, *, title: str
) -> dict[Path, bytes]:
    """What to write, by file."""
    contents: dict[Path, bytes] = {}
    if output is not None and learned.automaton is not None:
        from micah_plan.documents.model import model_text

        contents[output] = model_text(learned.automaton).encode()
    if figure is not None:
        from micah_plan.view.figures import png
        from micah_plan.view.learning_figure import learning_figure

        contents[figure] = png(learning_figure(learned.recording, learned.graph))
    if html is not None:
        from micah_plan.view.recording_page import recording_page

        contents[html] = recording_page(learned.recording, learned.graph, title=title).encode()
    return contents


def _list_topics(log: Path, as_json: bool) -> None:
    from micah_plan.recording.ros_bags import is_log, topics_of
    from micah_plan.recording.ros_log import READ

    if not is_log(log):
        problem = "only ROS logs have topics: .mcap, .bag, .db3 and folders of rosbag2"
        raise InputError(problem, source=log, remedy="leave out --list-topics")
    with located_in(log):
        topics = topics_of(log)

    def human() -> None:
        shown = table("topic", "type", "messages", "read")
        for topic in topics:
            shown.add_row(topic.name, topic.kind.replace("/msg/", "/"), str(topic.messages), READ.get(topic.kind, "no"))
        out.print(shown)

    rows = [{"name": topic.name, "type": topic.kind, "messages": topic.messages} for topic in topics]
    print_summary(as_json, {"topics": rows}, human)


def _edge(edge: KinematicEdge) -> dict[str, Any]:
    sure = edge.certainty
    return {
        "segments": [_segment(segment) for segment in edge.segments],
        "changepoints": list(edge.changepoints),
        "changepoint_counts": None if sure is None else sure.changepoint_counts,
        "action_channel": None if sure is None or sure.channel is None else _channel(sure.channel),
    }


def _segment(segment: Segment) -> dict[str, Any]:
    sure, no_single_joint = segment.certainty, segment.no_single_joint
    start = None if sure is None else sure.start
    data: dict[str, Any] = {
        "model": segment.joint.kind,
        "start": segment.start,
        "end": segment.end,
        "run": segment.run,
        "start_interval": None if start is None else start.interval(),
    }
    fitted = {
        "parameters": _parameters(segment.joint),
        **_spread(segment.joint),
        "configuration": [segment.configuration_start, segment.configuration_end],
        "probability": segment.probability,
        "probabilities": None if sure is None else dict(sure.kinds),
        "deviation": None if sure is None or sure.deviation is None else _deviation(sure.deviation),
    }
    if no_single_joint is None:
        return data | fitted
    misses = {
        "position_m": no_single_joint.position,
        "rotation_rad": no_single_joint.rotation,
        "position_noise_m": no_single_joint.position_noise,
        "rotation_noise_rad": no_single_joint.rotation_noise,
        "log_odds": no_single_joint.log_odds,
    }
    best = {"model": segment.joint.kind, **fitted}
    return data | {"model": "none", "parameters": {}, "best": best, "misfit": misses}


def _deviation(deviation: Deviation) -> dict[str, Any]:
    return {"position_m": deviation.position, "rotation_rad": deviation.rotation, "probability": deviation.probability}


def _parameters(joint: Joint) -> dict[str, Any]:
    """Pose at configuration 0; knots, or axis (unit, base frame), center, radius [m], pitch [m/rad] if they apply."""
    from micah_plan.automaton.joint import radius

    parameters: dict[str, Any] = {"position": joint.position, "orientation": joint.quaternion}
    if joint.kind == "path":
        return parameters | {"knots": joint.knots}
    if joint.moves:
        parameters["axis"] = joint.axis
    if joint.turns:
        parameters |= {"center": joint.center, "radius": float(radius(joint))}
    if joint.kind == "screw":
        parameters["pitch"] = joint.pitch
    return parameters


def _spread(joint: Joint) -> dict[str, Any]:
    """Covariance of a joint's parameters and their standard deviations, by name [rad, m, m/rad]."""
    if joint.covariance is None:
        return {"stds": None, "covariance": None}
    stds = dict(zip(joint.covariance.names, _stds(joint.covariance.matrix), strict=True))
    return {"stds": stds, "covariance": asdict(joint.covariance)}


def _channel(channel: ActionChannel) -> dict[str, Any]:
    from micah_plan.automaton.graph import CHANNEL_NAMES

    *turned, gain, delay = _stds(channel.covariance)
    return {
        **asdict(channel),
        "stds": {"frame_rotation": turned, "gain": gain, "delay": delay},
        "covariance": {"names": CHANNEL_NAMES, "matrix": channel.covariance},
    }


def _stds(matrix: Sequence[Sequence[float]]) -> list[float]:
    return [math.sqrt(max(row[i], 0.0)) for i, row in enumerate(matrix)]


def _print_learned(learned: Learned, files: tuple[Path | None, ...]) -> None:
    """A table of the segments of every edge, how its actions move it, and what was written."""
    from micah_plan.view.learned import action_words, deviation_notes

    line = " " if out.width >= _WIDE else "\n"
    for edge in learned.graph.edges:
        shown = table(*(name.replace("\n", line) for name in _COLUMNS), padding=(0, 1, 0, 0), title_justify="left")
        shown.title = learned.heading(edge)
        for name in _NARROW:
            shown.columns[_COLUMNS.index(name)].no_wrap = True
        for segment in edge.segments:
            shown.add_row(*(cell.replace("\n", line) for cell in segment_row(segment)))
        out.print(shown)
        print_lines(tuple(deviation_notes(edge.segments)))
        if edge.certainty is not None and edge.certainty.channel is not None:
            print_lines((f"actions: {action_words(edge.certainty.channel)}",))
    if learned.graph.probability is not None:
        out.print(f"probability of this tree of parts: {percent(min(learned.graph.probability, SUREST), 0)}")
    if learned.automaton is None:
        out.print(f"no model: {learned.reason}", style="yellow")
    else:
        modes = count(len(learned.automaton.modes), "mode")
        out.print(f"learned {modes} in {duration(learned.seconds)}")
    print_files(files)


def segment_row(segment: Segment) -> tuple[str, ...]:
    """One line of the table, short enough for 80 columns: kind of joint, rows, way, axis, radius, how sure, start."""
    from micah_plan.automaton.joint import axis_std, radius, radius_std

    joint, rows, no_single_joint, sure = (
        segment.joint,
        f"{segment.start}-{segment.end}",
        segment.no_single_joint,
        segment.certainty,
    )
    start = ""
    if sure is not None and sure.start is not None:
        first, last = sure.start.interval()
        start = f"{first}" if first == last else f"{first}-{last}"
    if no_single_joint is not None:
        return ("none", rows, f"misses by {quantity(no_single_joint.position, 'm')}", "", "", "", start)
    axis = "" if joint.kind in ("rigid", "path") else " ".join(f"{round(value, 2) + 0.0:.2f}" for value in joint.axis)
    arm = quantity(radius(joint), "m") if joint.turns else ""
    if joint.covariance is not None:
        axis += f"\n± {in_degrees(axis_std(joint), digits=2)}" if axis else ""
        arm += f"\n± {quantity(radius_std(joint), 'm', digits=2)}" if arm else ""
    passed = _passed(segment) if joint.moves else plain(segment.configuration_end)
    probability = segment.probability if sure is None else dict(sure.kinds).get(joint.kind, 0.0)
    return (joint.kind, rows, passed, axis, arm, percent(min(probability, SUREST), 0), start)


def _passed(segment: Segment) -> str:
    """Where a moving segment begins and ends, and where it turns around if it comes back from further on."""

    ends = [segment.configuration_start, segment.configuration_end]
    low, high = segment.configuration_range
    furthest = max((low, high), key=lambda value: min(abs(value - end) for end in ends))
    turned = min(abs(furthest - end) for end in ends) > 0.2 * (high - low)
    stops = [ends[0], furthest, ends[1]] if turned else ends
    return way(stops, segment.joint.unit)


def explore(
    scene: Annotated[Path, typer.Argument(help="Scene file (YAML).")],
    output: OutputPath,
    plant: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE.py:CLASS", help="nominal or mujoco: the object that the scene names; or your machine."
        ),
    ] = DEFAULT_PLANT,
    html: Annotated[Path | None, typer.Option(help="Write what was done and believed as a page.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Open what a hand holds without a model of it, with little force, and write the model that was found.

    With a plant of your own, give --plant FILE.py:CLASS: the class is called with the scene and has reset, apply and
    close. Exit code 0 if the object was opened or is held, 1 if neither can be said; a model is written if it moved.
    """
    from micah_plan.api import stages
    from micah_plan.cli.planning import named_plant
    from micah_plan.documents.experiment import load_scene
    from micah_plan.documents.kind import files_named_by
    from micah_plan.documents.model import model_text
    from micah_plan.files import replace_files

    check_outputs(files_named_by(scene), (Output("-o", output, MODEL), Output("--html", html, PAGE)))
    asked, machine = load_scene(scene), named_plant(plant)
    with progress_bar(as_json) as progress:
        exploration = stages.explore(asked, plant=machine, seed=seed, progress=progress)
    contents = {} if exploration.model is None else {output: model_text(exploration.model).encode()}
    if html is not None:
        from micah_plan.view.exploration_page import exploration_page

        contents[html] = exploration_page(exploration, title=title_of(scene)).encode()
    replace_files(contents)
    summary = _explored(exploration) | {"model": None if exploration.model is None else str(output), "seed": seed}
    print_summary(as_json, summary, lambda: _print_explored(exploration, tuple(contents)))
    if exploration.outcome == "gave_up":
        raise typer.Exit(NO_RESULT)


def _explored(exploration: Exploration) -> dict[str, Any]:
    """Keys of `explore`."""
    return {
        "outcome": exploration.outcome,
        "steps": exploration.steps,
        "max_force_n": exploration.largest_force,
        "joints": list(exploration.kinds),
        "probability": exploration.probability,
        "travel_m": exploration.travel,
        "seconds": exploration.seconds,
        "reason": exploration.reason,
        "notes": list(exploration.notes),
        "tried_n": exploration.tried,
        "hand_stiffness_n_per_m": 1.0 / exploration.hand.compliance,
        "slowest_step_cpu_s": exploration.thinking,
    }


def _print_explored(exploration: Exploration, files: tuple[Path, ...]) -> None:
    from micah_plan.api.formatting import explored_lines

    out.print("\n".join(explored_lines(exploration)))
    print_files(files)
