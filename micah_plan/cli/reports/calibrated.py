"""What `calibrate` says: verdict, effects, errors before and after, and what changed in the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from micah_plan.cli.console import out, print_files, print_lines, table
from micah_plan.documents.model_difference import Difference
from micah_plan.quantities import percent, plain, quantity
from micah_plan.residual.calibrate import Calibration, FoundEffect
from micah_plan.residual.missing_mode import MissingMode
from micah_plan.residual.trace import LaneTrace
from micah_plan.residual.verdict import SENTENCES


def calibrated(found: Calibration, seconds: float) -> dict[str, Any]:
    """Keys of `calibrate`."""
    return {
        "verdict": found.verdict,
        "effects": [_effect(effect) for effect in found.effects],
        "residual": {
            "before": {"one_step_rmse": found.before.one_step, "rollout_rmse": found.before.rollout},
            "after": {"one_step_rmse": found.after.one_step, "rollout_rmse": found.after.rollout},
            "noise_floor": found.noise_floor,
        },
        "unexplained_fraction": found.unexplained_fraction,
        "missing_modes": [_missing_mode(mode) for one in found.traces for mode in one.missing_modes],
        "coordinates": [_coordinate(one) for one in found.traces],
        "notes": list(found.notes),
        "next_experiment": found.experiment,
        "seconds": seconds,
    }


def _effect(found: FoundEffect) -> dict[str, Any]:
    effect = found.effect
    names = [name for name, _ in effect.parameters]
    return {
        "name": effect.name,
        "parameters": dict(effect.parameters) | dict(found.derived),
        "units": dict(zip(names, found.units, strict=True)) | {name: "s" for name, _ in found.derived},
        "evidence": found.evidence,
        "is_added": found.is_added,
        "interval_95": {name: list(pair) for name, pair in zip(names, found.interval, strict=True)},
        "coordinate": effect.coordinate,
        "modes": list(effect.modes),
        "since": None if found.since is None else {"run": found.since[0], "time_s": found.since[1]},
        "tied_with": list(found.tied),
        "separating_experiment": found.experiment or None,
        "sentence": found.sentence,
        "source": found.source,
    }


def _missing_mode(mode: MissingMode) -> dict[str, Any]:
    ends = {
        "from": mode.low if math.isfinite(mode.low) else None,
        "to": mode.high if math.isfinite(mode.high) else None,
    }
    return {"coordinate": mode.coordinate, "unit": mode.unit, **ends, "gain": mode.gain, "bias": mode.bias} | {
        "evidence": mode.evidence,
        "modes": list(mode.modes),
        "sentence": str(mode),
    }


def _coordinate(one: LaneTrace) -> dict[str, Any]:
    return {
        "name": one.lane.coordinate,
        "unit": one.lane.unit,
        "verdict": one.verdict,
        "unexplained_fraction": one.unexplained_fraction,
        "ranking": [
            {"name": name, "evidence": evidence, "standard_error": error} for name, evidence, error in one.ranking
        ],
        "autocorrelation": one.correlation,
        "whiteness_p": one.white_probability,
    }


def print_calibrated(summary: dict[str, Any], changes: Sequence[Difference], files: tuple[Path | None, ...]) -> None:
    """Verdict, effects and errors of a calibration."""
    out.print(f"{summary['verdict']}: {SENTENCES[summary['verdict']]}", markup=False)
    if summary["effects"]:
        shown = table("effect", "parameters", "evidence \\[nats]", "or instead")
        for effect in summary["effects"]:
            units = effect["units"]
            values = [f"{name} {quantity(value, units[name])}" for name, value in effect["parameters"].items()]
            name = f"{effect['name']} ({effect['coordinate']})" + ("" if effect["is_added"] else ", not added")
            shown.add_row(name, ", ".join(values), plain(effect["evidence"]), ", ".join(effect["tied_with"]))
        out.print(shown)
    residual = summary["residual"]
    units = {one["unit"] for one in summary["coordinates"]}
    unit = "m" if units == {"m"} else ""
    for name, text in (("one_step_rmse", "one step"), ("rollout_rmse", "roll-out")):
        before, after = (quantity(residual[when][name], unit) for when in ("before", "after"))
        out.print(f"  {text:9} {before} before, {after} after")
    out.print(f"  noise     {quantity(residual['noise_floor'], unit)} (one step)")
    out.print(f"  left unexplained: {percent(summary['unexplained_fraction'], 0)}", markup=False)
    for note in summary["notes"]:
        out.print(f"  note: {note}", markup=False)
    out.print(f"  next: {summary['next_experiment']}", markup=False)
    out.print("changes of the model:" if changes else "the model stays as it is", markup=False)
    print_lines(tuple(f"  {change}" for change in changes))
    print_files(files)
