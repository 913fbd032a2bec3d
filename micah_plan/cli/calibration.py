"""`micah-plan predict` and `calibrate`: a model against measured motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import (
    NO_RESULT,
    JsonFlag,
    OutputPath,
    drawn,
    out,
    progress_bar,
    write_and_print,
)
from micah_plan.cli.conventions import (
    Commands,
)
from micah_plan.cli.user_code import Code, load_code
from micah_plan.output_files import MODEL, PAGE, Output, check_outputs

if TYPE_CHECKING:
    from micah_plan.residual.next_experiment import Designed


def predict(
    model: Annotated[Path, typer.Argument(help="Model, or the problem or plan that was executed (YAML, JSON).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions.")],
    as_learned: Annotated[
        bool, typer.Option("--actions-as-learned", help="Apply the action channel that the model was learned with.")
    ] = False,
    commands: Commands = None,
    html: Annotated[Path | None, typer.Option(help="Write measured against predicted motion as a page.")] = None,
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """Compare measured motion with one-step and roll-out predictions, and their errors with the noise in the data.

    A held object has no model file of its own: give the problem or a plan instead.
    """
    from micah_plan.api.prediction import predict as predicted

    load_code(code)
    check_outputs((model, recording), (Output("--html", html, PAGE),))
    with progress_bar(as_json) as progress:
        result = predicted(model, recording, actions_as_learned=as_learned, commands=commands, progress=progress)
        progress("compare with the noise", 1.0)
        contents = drawn(result, recording.stem, html)
    write_and_print(result, contents, as_json)


def calibrate(
    model: Annotated[Path, typer.Argument(help="Model (YAML).")],
    recordings: Annotated[
        list[Path], typer.Argument(help="Recordings with actions: executed runs, experiments or a demonstration.")
    ],
    output: OutputPath,
    html: Annotated[
        Path | None, typer.Option("--html", "--report", help="Write the comparison and the effects as a page.")
    ] = None,
    experiment: Annotated[
        Path | None, typer.Option(help="Write the experiment that separates what stays open, if motion can.")
    ] = None,
    commands: Commands = None,
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """Find the effects that a model lacks and write the improved model; exit code 1 if some stay unexplained."""
    from micah_plan.api.calibration import calibrate as calibrated
    from micah_plan.documents.experiment import experiment_text
    from micah_plan.documents.kind import files_named_by
    from micah_plan.documents.model import load_model, model_text
    from micah_plan.residual.next_experiment import next_experiment

    outputs = Output("-o", output, MODEL), Output("--html", html, PAGE), Output("--experiment", experiment, MODEL)
    load_code(code)
    check_outputs((*files_named_by(model), *recordings), outputs)
    automaton = load_model(model)
    with progress_bar(as_json) as progress:
        measured = recordings[0] if len(recordings) == 1 else recordings
        result = calibrated(automaton, measured, commands=commands, progress=progress)
    contents = {output: model_text(result.automaton).encode()}
    designed = None if experiment is None else next_experiment(automaton, result.recording, result.calibration)
    if experiment is not None and designed is not None:
        contents[experiment] = experiment_text(designed.experiment, model, experiment, str(designed)).encode()
    contents |= drawn(result, recordings[0].stem, html)
    more = {} if experiment is None else {"experiment": None if designed is None else _experiment_json(designed)}
    write_and_print(result, contents, as_json, more)
    if experiment is not None and not as_json:
        out.print(f"experiment {designed or 'not written: no commands along a joint would be informative'}")
    if not result.success:
        raise typer.Exit(NO_RESULT)


def _experiment_json(designed: Designed) -> dict[str, Any]:
    """JSON of an experiment: the separated pairs with their expected evidence [nats]."""
    pairs = [{"between": [first, second], "expected_nats": nats} for first, second, nats in designed.expected]
    return {"coordinate": designed.coordinate, "pairs": pairs, "sentence": str(designed)}
