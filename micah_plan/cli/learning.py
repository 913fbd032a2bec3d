"""`micah-plan learn` and `explore`: from a recording, or from the first touch, to a model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from micah_plan.cli.console import (
    NO_RESULT,
    JsonFlag,
    OutputPath,
    Seed,
    drawn,
    out,
    print_summary,
    progress_bar,
    table,
    title_of,
    write_and_print,
)
from micah_plan.cli.conventions import (
    Columns,
    Commands,
    ConventionOptions,
    Frame,
    JointRanges,
    Order,
    PartName,
    PositionsOnly,
    Rate,
    Robot,
    Tool,
    Topics,
    Units,
    Up,
)
from micah_plan.errors import InputError, located_in, shown
from micah_plan.output_files import FIGURE, MODEL, PAGE, Output, check_outputs
from micah_plan.task.plants import DEFAULT_PLANT

if TYPE_CHECKING:
    from micah_plan.learning.settings import LearnSettings


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
    joint_ranges: JointRanges = None,
    commands: Commands = None,
    positions_only: PositionsOnly = False,
    list_topics: Annotated[bool, typer.Option("--list-topics", help="Only list the content of a ROS log.")] = False,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A setting of learning, as kinds=rigid,screw; repeatable."),
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the segmented track as PNG.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the segmented track as a page.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Accepted as by other commands: learning is deterministic.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Learn a hybrid automaton from a recording and save it as YAML; exit code 1 if no single joint fits some rows."""
    if list_topics:
        _list_topics(recording, as_json)
        raise typer.Exit
    if output is None:
        raise InputError("missing option '-o' / '--output'", remedy="see micah-plan learn --help")
    conventions_given = ConventionOptions(
        columns, units, rate, up, quaternion, name, topic, frame, robot, tool, joint_ranges, commands, positions_only
    )
    from micah_plan.api.learning import learn as learned
    from micah_plan.documents.model import model_text
    from micah_plan.documents.parts import load_parts

    asked = Output("-o", output, MODEL), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    check_outputs((recording, parts), asked)
    shapes, settings = () if parts is None else load_parts(parts), _settings(setting or ())
    with progress_bar(as_json) as progress:
        options: dict[str, Any] = {"method": method, "seed": seed, "parts": shapes, "settings": settings, "base": base}
        result = learned(recording, conventions=conventions_given.conventions(), progress=progress, **options)
    model = {} if result.automaton is None else {output: model_text(result.automaton).encode()}
    write_and_print(result, model | drawn(result, recording.stem, html, figure), as_json)
    if not result.success:
        raise typer.Exit(NO_RESULT)


def _settings(texts: Sequence[str]) -> LearnSettings:
    """The settings of learning with changes given as NAME=VALUE.

    Raises:
        InputError: for a name that is none, and a value that is none of it.
    """
    from micah_plan.api.inputs import learn_settings
    from micah_plan.learning.settings import LearnSettings

    changes: dict[str, Any] = {}
    for text in texts:
        name, equals, value = (piece.strip() for piece in text.partition("="))
        if not (name and equals and value) or name in changes:
            problem = f"expected NAME=VALUE, each once, found {shown(text)}"
            raise InputError(problem, source="--set", remedy="e.g. --set position_wander=0.001")
        changes[name] = _setting(name, value, getattr(LearnSettings(), name, None))
    return learn_settings(None, changes)


def _setting(name: str, text: str, default: Any) -> Any:
    """The value of a setting in the type of its default.

    Raises:
        InputError: if the text is none.
    """
    if isinstance(default, tuple):
        return tuple(piece.strip() for piece in text.split(","))
    from micah_plan.recording.text import is_number

    expected: str
    value: float | None
    if isinstance(default, bool):
        expected, value = "true or false", {"true": True, "false": False}.get(text.lower())
    elif isinstance(default, int):
        expected, value = "a whole number", int(text) if text.isdecimal() and len(text) < 10 else None
    else:
        expected, value = "a number", float(text) if is_number(text) else None
        if default is None and text.lower() == "none":
            return None
    if value is None:
        problem = f"expected {expected} for {name}, found {shown(text)}"
        raise InputError(problem, source="--set", remedy="e.g. --set position_wander=0.001")
    return value


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
    """Open a held object without a model of it, with little force, and write the model that was found.

    With a plant of your own, give --plant FILE.py:CLASS: the class is called with the scene and has reset, apply and
    close. Exit code 0 if the object was opened or is held, 1 if neither can be said; a model is written if it moved.
    """
    from micah_plan.api.exploration import explore as explored
    from micah_plan.cli.plants import named_plant
    from micah_plan.documents.kind import files_named_by
    from micah_plan.documents.model import model_text

    check_outputs(files_named_by(scene), (Output("-o", output, MODEL), Output("--html", html, PAGE)))
    machine = named_plant(plant)
    with progress_bar(as_json) as progress:
        result = explored(scene, plant=machine, seed=seed, progress=progress)
    model = {} if result.automaton is None else {output: model_text(result.automaton).encode()}
    written = {"model": None if result.automaton is None else str(output)}
    write_and_print(result, model | drawn(result, title_of(scene), html), as_json, written)
    if not result.success:
        raise typer.Exit(NO_RESULT)
