"""`micah-plan new`, `convert` and `schema`: template files, files in other formats, and the schemas of ours."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from micah_plan.cli.console import (
    JsonFlag,
    print_files,
    print_summary,
    print_warnings,
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
from micah_plan.errors import InputError, shown
from micah_plan.output_files import PLAN, Output, check_outputs

if TYPE_CHECKING:
    pass


def new(
    kind: Annotated[Literal["problem", "effect", "robot", "sweep", "tags"], typer.Argument(help="What to write.")],
    folder: Annotated[Path, typer.Argument(help="Folder for the files; created if it does not exist.")],
    model: Annotated[Path | None, typer.Option(help="Only for a problem: the model (YAML) of its object.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a commented problem, effect, sweep, problem with a robot, or tags to print; existing files are kept."""
    from micah_plan.templates.write import write_template

    written = write_template(kind, folder, model=model)
    print_summary(as_json, {"files": [str(path) for path in written]}, lambda: print_files(written))


def convert(
    source: Annotated[Path, typer.Argument(help="Recording, plan, model (YAML), URDF, SDF or MJCF.")],
    target: Annotated[Path, typer.Argument(help="File to write; its suffix chooses the format.")],
    topic: Topics = None,
    frame: Frame = None,
    robot: Robot = None,
    tool: Tool = None,
    joint_ranges: JointRanges = None,
    part: Annotated[str | None, typer.Option(help="Of a recording, the part to write; default: all.")] = None,
    run: Annotated[int | None, typer.Option(help="Of a recording, the run to write; default: all.")] = None,
    poses_only: Annotated[
        bool, typer.Option("--poses-only", help="Of a recording, leave out actions, forces and other columns.")
    ] = False,
    columns: Columns = None,
    units: Units = None,
    rate: Rate = None,
    up: Up = None,
    quaternion: Order = None,
    name: PartName = None,
    commands: Commands = None,
    positions_only: PositionsOnly = False,
    density: Annotated[
        float, typer.Option(min=1.0, max=30000.0, help="Of a model's shapes [kg/m^3], for the masses of bodies.")
    ] = 500.0,
    package: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FOLDER", help="Of URDF and SDF, where a package of meshes lies; may be repeated."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Convert recordings (also ROS bags), plans (to JointTrajectory) and models (to and from URDF, SDF and MJCF)."""
    from micah_plan.exchange.convert import convert as converted
    from micah_plan.exchange.convert import targets

    check_outputs((source,), (Output("the target", target, targets(source)),))
    options_given = ConventionOptions(
        columns, units, rate, up, quaternion, name, topic, frame, robot, tool, joint_ranges, commands
    )
    kind, notes = converted(
        source,
        target,
        part=part,
        run=run,
        poses_only=poses_only,
        density=density,
        packages=_packages(package or ()),
        conventions=replace(options_given, positions_only=positions_only).conventions(),
    )
    print_warnings(notes)
    summary = {"kind": kind, "notes": list(notes), "file": str(target), "bytes": target.stat().st_size}
    print_summary(as_json, summary, lambda: print_files((target,)))


def _packages(options: Sequence[str]) -> dict[str, str]:
    """Folder by package name, from NAME=FOLDER."""
    packages: dict[str, str] = {}
    for text in options:
        name, equals, folder = text.partition("=")
        if not (name and equals and Path(folder).is_dir()):
            problem = f"expected NAME=FOLDER with a folder that exists, found {shown(text)}"
            raise InputError(problem, source="--package", remedy="e.g. --package cupboard_description=../cupboard")
        packages[name] = str(Path(folder).resolve())
    return packages


def schema(
    kind: Annotated[
        Literal["problem", "model", "parts", "scene", "sweep", "experiment", "conventions", "tags", "plan"],
        typer.Argument(help="The kind of file."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write (.json); default: stdout.")
    ] = None,
) -> None:
    """Print the JSON Schema of a file, with which editors complete, explain and check it."""
    from micah_plan.documents.kind import schema as described
    from micah_plan.files import replace_file

    check_outputs((), (Output("-o", output, PLAN),))
    text = json.dumps(described(kind), indent=2)
    if output is None:
        print(text)
        return
    replace_file(output, (text + "\n").encode())
    print_files((output,))
