"""`micah-plan track`: from a camera to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from micah_plan.cli.console import JsonFlag, OutputPath, progress_bar, write_and_print
from micah_plan.errors import InputError
from micah_plan.files import PAGE, TABLE, Output, check_outputs

if TYPE_CHECKING:
    from micah_plan.api.result import Result


def track(
    source: Annotated[
        Path,
        typer.Argument(help="Video, folder of pictures with their times in stamps.txt, or tracks of points (NPZ)."),
    ],
    output: OutputPath,
    tags: Annotated[Path | None, typer.Option(help="Which printed tags are on which part (YAML); of a video.")] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="Intrinsics: ROS camera_info, OpenCV, Kalibr or RealSense; default: found from the tags."),
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="PART", help="Part in whose frame poses are; default: base, or the first.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", min=0.01, max=100_000.0, help="Frames per second, if it says wrong.")
    ] = None,
    units: Annotated[str, typer.Option(help="Of points: m, cm, mm or in.")] = "m",
    axes: Annotated[
        Literal["points,frames", "frames,points"] | None, typer.Option(help="Of points: order of the array's axes.")
    ] = None,
    points: Annotated[Path | None, typer.Option(help="Write which point is on which body (CSV).")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the tracks as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Track parts with printed tags in a video, or bodies in tracks of points, and write their poses for `learn`."""
    from micah_plan.api.tracking import track as tracked
    from micah_plan.api.tracking import track_bodies
    from micah_plan.recording.csv_file import csv_bytes
    from micah_plan.vision.track_points import points_table

    asked = (Output("-o", output, TABLE[:1]), Output("--points", points, TABLE[:1]), Output("--html", html, PAGE))
    check_outputs((source, tags, camera), asked)
    is_points = source.suffix.lower() == ".npz"
    needless = (
        {"--tags": tags, "--camera": camera, "--base": base} if is_points else {"--axes": axes, "--points": points}
    )
    for option, value in needless.items():
        if value is not None:
            what = "a video" if is_points else "tracks of points (NPZ)"
            raise InputError(f"only {what} can be given it", source=option, remedy="leave it out")
    files = {}
    with progress_bar(as_json) as progress:
        if is_points:
            of_points = track_bodies(source, rate=rate, axes=axes, units=units)
            files = {} if points is None else {points: points_table(of_points.tracked)}
            result: Result = of_points
            recording = of_points.recording
        elif tags is None:
            remedy = "say which tag is on which part in a YAML file; micah-plan schema tags describes it"
            raise InputError("missing option '--tags'", remedy=remedy)
        else:
            of_tags = tracked(source, tags, camera=camera, base=base, rate=rate, progress=progress)
            result, recording = of_tags, of_tags.recording
    pages = {} if html is None else {html: result.page(source.stem).encode()}
    write_and_print(result, {output: csv_bytes(recording, output), **files, **pages}, as_json)
