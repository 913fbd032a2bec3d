"""`micah-plan learn`: from a recording to a model."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli.console import NO_RESULT, JsonFlag, OutputPath, Seed, print_summary, print_warnings, progress_bar
from micah_plan.errors import InputError
from micah_plan.outputs import FIGURE, MODEL, PAGE, Output, check_outputs


class LearnMethod(StrEnum):
    """How segments are scored: with the actions or by the poses alone."""

    ACT_CHAMP = "act-champ"
    CHAMP = "champ"


def learn(
    recording: Annotated[Path, typer.Argument(help="Recording (CSV, TUM text, NPZ or MCAP).")],
    output: OutputPath,
    method: Annotated[
        LearnMethod, typer.Option(help="Score segments with or without the actions.")
    ] = LearnMethod.ACT_CHAMP,
    parts: Annotated[
        Path | None, typer.Option(help="Shapes and handles of the parts (YAML), added to the model.")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the segmented track as PNG.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the segmented track as a page.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Learn a hybrid automaton from a recording and save it as YAML; exit code 1 if no single joint fits some rows."""
    from micah_plan import workflow
    from micah_plan.cli.reports import learned as reports
    from micah_plan.documents.model import dump_model
    from micah_plan.documents.parts import load_parts
    from micah_plan.files import replace_file
    from micah_plan.learn.settings import FEWEST_ROWS

    written = Output("-o", output, MODEL), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    check_outputs((recording, parts), written)
    shapes = () if parts is None else load_parts(parts)
    with progress_bar(as_json) as progress:
        measured = workflow.read(recording, minimum_rows=FEWEST_ROWS)
        try:
            learned = workflow.learn(measured, method=method.value, seed=seed, parts=shapes, progress=progress)
        except InputError as error:
            raise error.located(recording) from None
    print_warnings(learned.warnings)
    if learned.automaton is not None:
        dump_model(learned.automaton, output)
    if figure is not None:
        from micah_plan.view.figures import save_figure
        from micah_plan.view.learning_figure import learning_figure

        save_figure(learning_figure(learned.recording, learned.graph), figure)
    if html is not None:
        from micah_plan.view.recording_page import recording_page

        replace_file(html, recording_page(learned.recording, learned.graph, title=recording.stem).encode())
    summary = reports.learned(learned, seed)
    files = (output if learned.automaton is not None else None, figure, html)
    print_summary(as_json, summary, lambda: reports.print_learned(learned, files))
    if learned.automaton is None:
        raise typer.Exit(NO_RESULT)
