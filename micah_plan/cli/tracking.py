"""`micah-plan track`: from a camera to a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from micah_plan.cli.console import JsonFlag, OutputPath, print_files, print_summary, progress_bar, write_and_print
from micah_plan.errors import InputError
from micah_plan.files import replace_file
from micah_plan.output_files import MODEL, PAGE, TABLE, Output, check_outputs

if TYPE_CHECKING:
    from micah_plan.api.tracking import PointsResult, TrackResult
    from micah_plan.summaries import Progress
    from micah_plan.vision.point_files import Axes


def track(
    source: Annotated[
        Path,
        typer.Argument(help="Video, folder of pictures with stamps.txt, or tracks of points (NPZ, TRC, C3D, CSV)."),
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
        float | None,
        typer.Option(metavar="HZ", min=0.01, max=100_000.0, help="Frames per second, if its own are wrong."),
    ] = None,
    actions: Annotated[
        Path | None, typer.Option(help="Recording of what a robot was commanded meanwhile, by its own clock.")
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Time of the actions minus time of the video; default: from the motion."),
    ] = None,
    units: Annotated[str | None, typer.Option(help="Of points: m, cm, mm or in; default: the file's, or m.")] = None,
    axes: Annotated[
        Literal["points,frames", "frames,points"] | None, typer.Option(help="Of points: order of the array's axes.")
    ] = None,
    points: Annotated[Path | None, typer.Option(help="Write which point is on which body (CSV).")] = None,
    board: Annotated[
        str | None,
        typer.Option(metavar="9x6,30mm,22mm", help="The video is of this ChArUco board: write the camera (YAML)."),
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write the tracks as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Track parts with printed tags in a video, or bodies in tracks of points, and write their poses for `learn`."""
    if board is not None:
        _camera(source, board, output, as_json)
        return
    asked = (Output("-o", output, TABLE[:1]), Output("--points", points, TABLE[:1]), Output("--html", html, PAGE))
    check_outputs((source, tags, camera, actions), asked)
    from micah_plan.recording.csv_file import csv_bytes
    from micah_plan.vision.point_files import POINT_FILES

    is_points = source.suffix.lower() in POINT_FILES
    of_video = {"--tags": tags, "--base": base, "--actions": actions, "--offset": offset}
    of_points = {"--axes": axes, "--points": points, "--units": units}
    _refuse(of_video if is_points else of_points, "a video" if is_points else "tracks of points")
    result: PointsResult | TrackResult
    files: dict[Path, bytes] = {}
    with progress_bar(as_json) as progress:
        if is_points:
            result, files = _of_points(source, rate, axes, units, camera, points)
        else:
            result = _of_video(source, tags, camera, base, rate, actions, offset, progress)
    files |= {} if html is None else {html: result.page(source.stem).encode()}
    write_and_print(result, {output: csv_bytes(result.recording, output), **files}, as_json)


def _refuse(options: Mapping[str, object], needed: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise InputError(f"only {needed} can be given it", source=option, remedy="leave it out")


def _of_points(
    source: Path, rate: float | None, axes: Axes | None, units: str | None, camera: Path | None, points: Path | None
) -> tuple[PointsResult, dict[Path, bytes]]:
    from micah_plan.api.tracking import track_bodies
    from micah_plan.vision.track_points import points_table

    result = track_bodies(source, rate=rate, axes=axes, units=units, camera=camera)
    return result, {} if points is None else {points: points_table(result.tracked)}


def _of_video(
    source: Path,
    tags: Path | None,
    camera: Path | None,
    base: str | None,
    rate: float | None,
    actions: Path | None,
    offset: float | None,
    progress: Progress,
) -> TrackResult:
    from micah_plan.api.tracking import track as tracked

    if tags is None:
        remedy = "name the tags of each part: micah-plan new tags FOLDER writes a file to start from"
        raise InputError("missing option '--tags'", remedy=remedy)
    if offset is not None and actions is None:
        raise InputError("there are no actions to shift", source="--offset", remedy="add --actions ROBOT.csv")
    given = {"camera": camera, "base": base, "rate": rate, "actions": actions, "offset": offset}
    return tracked(source, tags, progress=progress, **given)  # type: ignore[arg-type]


def _camera(video: Path, text: str, output: Path, as_json: bool) -> None:
    """Write the intrinsics from a video of a calibration board."""
    from micah_plan.vision.board import board_of, camera_of_board, camera_text

    check_outputs((video,), (Output("-o", output, MODEL),))
    camera, rms, views = camera_of_board(video, board_of(text))
    replace_file(output, camera_text(camera).encode())
    focal, share = float(camera.matrix[0, 0]), camera.uncertainty
    summary = {"focal_length_px": focal, "focal_length_std_px": focal * share, "rms_px": rms, "views": views}

    def print_lines() -> None:
        print(
            f"focal length {focal:.1f} +- {2.0 * focal * share:.1f} px, corners known to {rms:.2f} px in {views} views"
        )
        print_files((output,))

    print_summary(as_json, summary, print_lines)
