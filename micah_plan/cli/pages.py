"""`micah-plan show`: a recording, a model, a problem, a plan or a folder of them as a page."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from micah_plan.cli.console import JsonFlag, print_files, print_lines, print_summary, progress_bar, title_of
from micah_plan.cli.user_code import Code, load_code
from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import replace_files
from micah_plan.output_files import PAGE, Output, check_outputs
from micah_plan.view.video import PICTURE, VIDEO, Filming

if TYPE_CHECKING:
    from micah_plan.recording.value import Recording

MOST_RECORDINGS = 2
"""Of runs beside a plan: before and after."""
View = Literal["whole", "motion", "object", "front", "side", "top"]


def show(
    file: Annotated[Path, typer.Argument(help="A recording, a model, a problem, a plan, or a folder.")],
    runs: Annotated[
        list[Path] | None,
        typer.Argument(help="Executed runs of the plan (a recording), to show with it; two: before, after."),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Page to write.")] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film the page: .mp4, .gif or .webp; needs the extra 'browser'.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Photograph the page: .png; needs the extra 'browser'.")] = None,
    scene: Annotated[Path | None, typer.Option(help="Write the 3-D scene alone, in MeshCat's own viewer.")] = None,
    at: Annotated[float, typer.Option(min=0, max=1, help="Share of the time at which --picture is taken.")] = 0.5,
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels of --video and --picture.")] = "1280x720",
    fps: Annotated[float, typer.Option(help="Frames per second of --video.")] = 15.0,
    speed: Annotated[float, typer.Option(help="How fast --video plays; 2: twice as fast.")] = 1.0,
    view: Annotated[View | None, typer.Option(help="What --video and --picture look at.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the page to this machine's browsers until Ctrl-C.")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of --live; 0: any free one.")] = 0,
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a page, a picture or a video of a recording, a model, a problem, a plan (with its runs), or serve the page.

    With --live the page is made again when the file changes. Of a folder it lists the files, their pages and the next
    command.
    """
    from micah_plan.view.live import remade_on_change

    wanted = {
        "-o": (output, PAGE),
        "--video": (video, VIDEO),
        "--picture": (picture, PICTURE),
        "--scene": (scene, PAGE),
    }
    load_code(code)
    files = {option: path for option, (path, _) in wanted.items() if path is not None}
    if not files and not live:
        raise InputError("no output is named", remedy="name a file with -o, or serve the page with --live")
    runs = runs or []
    _check_runs(file, runs)
    check_outputs((file, *runs), [Output(option, *where) for option, where in wanted.items()])
    if file.is_dir():
        _show_folder(file, files, live, as_json)
        return
    filming = _filming(size, fps, speed, view)
    with progress_bar(as_json) as progress:
        current = remade_on_change(file, lambda: _page_of(file, runs, progress))
        page = current()
        _write(page, files, at, filming, progress)
    names = {"-o": "page"}
    written = {names.get(option, option[2:]): str(path) for option, path in files.items()}
    summary: dict[str, str | int] = {"kind": _kind_of(file), **written, "bytes": len(page.encode())}
    if not live:
        print_summary(as_json, summary, lambda: print_files(files.values()))
        return
    _serve(current, port, summary, list(files.values()), as_json)


def _check_runs(file: Path, runs: Sequence[Path]) -> None:
    """Refuse recordings next to anything but a plan, and more than two."""
    if runs and (file.is_dir() or _kind_of(file) != "plan"):
        raise InputError("only a plan is shown with runs", source=file, remedy="name the plan first, then its runs")
    if len(runs) > MOST_RECORDINGS:
        problem = f"expected the runs before and after a change, found {len(runs)} recordings"
        raise InputError(problem, source=runs[MOST_RECORDINGS], remedy="name at most two")


def _serve(
    current: Callable[[], str], port: int, summary: dict[str, str | int], files: list[Path], as_json: bool
) -> None:
    """Serve the current page until Ctrl-C."""
    from micah_plan.view.live import PageServer

    with PageServer(current, port) as server:
        summary["url"] = server.url
        print_summary(as_json, summary, lambda: print_files(files))
        if not as_json:
            leave = "for this machine only; reload it after a change, leave with Ctrl-C"
            print_lines((f"the page is at {server.url} {leave}",))
        sys.stdout.flush()  # a program that started this waits for the address
        with suppress(KeyboardInterrupt):  # how to end it
            server.serve_forever()


def _show_folder(folder: Path, files: Mapping[str, Path], live: bool, as_json: bool) -> None:
    from micah_plan.api.folder import page_of, read_folder

    if live or list(files) != ["-o"]:
        raise InputError("of a folder there is a page only", source=folder, remedy="name it with -o, and nothing else")
    found = read_folder(folder, [files["-o"]])
    page = page_of(found).encode()
    replace_files({files["-o"]: page})
    command, why = found.step
    summary = {"kind": "folder", "page": str(files["-o"]), "files": len(found.files), "next": command}

    def print_saved() -> None:
        print_files(files.values())
        if command:
            print_lines((f"next: {command}  ({why})",))

    print_summary(as_json, summary | {"bytes": len(page)}, print_saved)


def _filming(size: str, rate: float, speed: float, view: str | None) -> Filming:
    width, _, height = size.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size must be WIDTHxHEIGHT, found {shown(size)}", remedy="for instance 1280x720")
    return Filming(int(width), int(height), rate, speed, view or "")


def _write(
    page: str, files: Mapping[str, Path], at: float, filming: Filming, progress: Callable[[str, float], None]
) -> None:
    """Write the requested outputs atomically."""
    from micah_plan.view.page import bare_scene
    from micah_plan.view.video import picture, video

    contents: dict[Path, bytes] = {}
    for option, path in files.items():
        if option == "--video":
            contents[path] = video(page, path.suffix.lower(), filming, progress)
        elif option == "--picture":
            contents[path] = picture(page, at, filming)
        else:
            contents[path] = (bare_scene(page) if option == "--scene" else page).encode()
    replace_files(contents)


def _kind_of(file: Path) -> str:
    """The kind of page for a file; unknown files are read as models, which reports the fault."""
    from micah_plan.documents.kind import kind_of

    kind = kind_of(file)
    return str(kind) if kind in ("plan", "problem", "recording") else "model"


def _by_file_name(runs: Sequence[Path]) -> dict[str, Recording]:
    """Recordings by file name; by path where names repeat."""
    from micah_plan.exchange.load import load_recording

    names = [path.name for path in runs]
    names = names if len(set(names)) == len(names) else [str(path) for path in runs]
    return {name: load_recording(path) for name, path in zip(names, runs, strict=True)}


def _page_of(file: Path, runs: Sequence[Path], progress: Callable[[str, float], None]) -> str:
    from micah_plan.api.learning import is_long_enough, learn
    from micah_plan.exchange.load import load_recording

    kind = _kind_of(file)
    if kind == "problem":
        from micah_plan.documents.problem import load_problem
        from micah_plan.view.plan_page import problem_page

        return problem_page(load_problem(file), title=title_of(file))
    if kind == "model":
        from micah_plan.documents.model import load_model
        from micah_plan.view.model_page import model_page

        return model_page(load_model(file), title=title_of(file))
    if kind == "plan":
        from micah_plan.documents.plan import load_plan
        from micah_plan.view.plan_page import plan_page

        stored = load_plan(file)
        executed = _by_file_name(runs) if runs else None
        return plan_page(stored.plan, stored.problem, title=title_of(file), executed=executed)
    from micah_plan.view.recording_page import recording_page

    recording = load_recording(file)
    if not is_long_enough(recording):  # the track alone is still worth seeing
        return recording_page(recording, None, title=title_of(file))
    with located_in(file):
        return learn(recording, progress=progress).page(title_of(file))
