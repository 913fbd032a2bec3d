"""`micah-plan track`: from a camera to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli.console import JsonFlag, OutputPath, progress_bar, write_and_print
from micah_plan.files import PAGE, Output, check_outputs


def track(
    video: Annotated[Path, typer.Argument(help="Video, or folder of pictures with their times in stamps.txt.")],
    output: OutputPath,
    tags: Annotated[Path, typer.Option(help="Which printed tags are on which part (YAML).")],
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
    html: Annotated[Path | None, typer.Option(help="Write the tracks as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Track parts with printed tags in a video, and write their poses as a recording for `learn`."""
    from micah_plan.api.tracking import track as tracked
    from micah_plan.recording.csv_file import csv_bytes

    check_outputs((video, tags, camera), (Output("-o", output, (".csv",)), Output("--html", html, PAGE)))
    with progress_bar(as_json) as progress:
        result = tracked(video, tags, camera=camera, base=base, rate=rate, progress=progress)
    pages = {} if html is None else {html: result.page(video.stem).encode()}
    write_and_print(result, {output: csv_bytes(result.recording, output), **pages}, as_json)
