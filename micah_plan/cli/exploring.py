"""`micah-plan explore`: from the first touch to a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import (
    NO_RESULT,
    JsonFlag,
    OutputPath,
    Seed,
    out,
    print_files,
    print_summary,
    progress_bar,
    title_of,
)
from micah_plan.outputs import MODEL, PAGE, Output, check_outputs
from micah_plan.task.plants import DEFAULT_PLANT

if TYPE_CHECKING:
    from micah_plan.explore.run import Exploration


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
    from micah_plan import workflow
    from micah_plan.cli.own_plant import named_plant
    from micah_plan.documents.exploration import load_scene
    from micah_plan.documents.model import model_text
    from micah_plan.files import replace_files

    check_outputs((scene,), (Output("-o", output, MODEL), Output("--html", html, PAGE)))
    asked, machine = load_scene(scene), named_plant(plant)
    with progress_bar(as_json) as progress:
        found = workflow.explore(asked, plant=machine, seed=seed, progress=progress)
    contents = {} if found.model is None else {output: model_text(found.model).encode()}
    if html is not None:
        from micah_plan.view.exploration_page import exploration_page

        contents[html] = exploration_page(found, title=title_of(scene)).encode()
    replace_files(contents)
    summary = _explored(found) | {"model": None if found.model is None else str(output), "seed": seed}
    print_summary(as_json, summary, lambda: _print_explored(found, tuple(contents)))
    if found.outcome == "gave_up":
        raise typer.Exit(NO_RESULT)


def _explored(found: Exploration) -> dict[str, Any]:
    """Keys of `explore`."""
    return {
        "outcome": found.outcome,
        "steps": found.steps,
        "max_force_n": found.largest_force,
        "joints": list(found.kinds),
        "probability": found.probability,
        "travel_m": found.travel,
        "seconds": found.seconds,
        "reason": found.reason,
        "notes": list(found.notes),
        "tried_n": found.tried,
        "hand_stiffness_n_per_m": 1.0 / found.hand.compliance,
        "slowest_step_cpu_s": found.thinking,
    }


def _print_explored(found: Exploration, files: tuple[Path, ...]) -> None:
    from micah_plan.front.words import explored_lines

    out.print("\n".join(explored_lines(found)))
    print_files(files)
