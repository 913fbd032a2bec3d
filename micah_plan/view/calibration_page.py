"""The page of a calibration: data, missing effects with their evidence, remaining errors, and the next experiment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from micah_plan.arrays import INTERVAL_STDS, Floats
from micah_plan.quantities import count, interval, percent, plain, quantity, with_spread
from micah_plan.residual.calibrate import began
from micah_plan.residual.calibration import Calibration, FoundEffect
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.messages import VERDICTS, Verdict
from micah_plan.residual.prediction import trajectory_errors
from micah_plan.residual.trace import CoordinateTrace
from micah_plan.summaries import Table, listed
from micah_plan.view.chart import Chart, Curve, Level, Panel, evenly, widened
from micah_plan.view.learned_words import capital
from micah_plan.view.page import Bar, Bars, Status, render
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.prediction_page import calibration_scene

_BADGES: dict[Verdict, tuple[str, Status]] = {
    "none": ("nothing is missing", "good"),
    "explained": ("explained", "good"),
    "partly": ("explained in part", "fair"),
    "unexplained": ("not explained", "bad"),
}
_MOST_RUNS, _MOST_BARS, _MOST_DRAWN, _MOST_TELLING = 60, 12, 4, 2
_HEIGHT = 140.0
_SHARE_SHOWN = 0.995
_SIDE = 1.5
"""Where the axis of directions ends: dots of commands forward lie around 1, those backward around -1."""


def calibration_page(calibration: Calibration, title: str) -> str:
    """The page as self-contained HTML text; equal values give equal bytes."""
    modes = [mode for trace in calibration.traces for mode in trace.missing_modes]
    gain = "It predicts {} nats better than any gradual change."
    coordinates = [_coordinate(trace) for trace in calibration.traces]
    names = listed([trace.data.coordinate for trace in calibration.traces])
    page = {
        "title": f"{names}: measured motion against the model",
        "kind": f"calibration with {title}",
        "badge": _badge(calibration),
        "headline": _headline(calibration),
        "message": f"{VERDICTS[calibration.verdict].capitalize()}.",
        "notes": calibration.notes,
        "modes": [f"{capital(str(mode))}. {gain.format(plain(mode.evidence))}" for mode in modes],
        "parameters": _parameters(calibration),
        "effects": [_effect(effect) for effect in calibration.effects],
        "errors": _errors(calibration),
        "poses": _poses(calibration),
        "unexplained": f"Left unexplained: {percent(calibration.unexplained_fraction, 0)} of the error that could be "
        "explained.",
        "coordinates": coordinates,
        "first": coordinates[max(range(len(coordinates)), key=lambda k: _worth(calibration.traces[k]))]["motion"][:2],
        "experiment": f"{capital(calibration.experiment)}.",
        "scene": calibration_scene(calibration, f"{names}: before and after"),
    }
    return render("calibration.html.j2", page=page)


def _headline(calibration: Calibration) -> str:
    """Summary of the effects found and of the errors before and after, in one or two sentences."""
    runs = count(len(calibration.recording.runs), "run")
    added = [effect for effect in calibration.effects if effect.is_added]
    changes = []
    for error in calibration.errors:
        of = f" of {error.of}" if error.of else ""
        for what, name in (("roll-outs", "rollout"), ("single steps", "one_step")):
            before, after = (quantity(getattr(size, name), error.unit) for size in (error.before, error.after))
            changes.append(f"{what}{of} from {before} to {after}" if added else f"{before} in {what}{of}")
    if not added:
        return f"Over {runs} the model misses by {listed(changes)}."
    named = listed([f"{effect.effect.name} ({_values(effect)})" for effect in added])
    return f"Over {runs}: {named}. Errors on rows that no fit saw: {listed(changes)}."


def _values(effect: FoundEffect) -> str:
    """The parameters of an effect, with stds where fitted."""
    texts = []
    for name, value, unit, low, high in effect.rows:
        std = (high - low) / (2.0 * INTERVAL_STDS)
        number = with_spread(value, std, unit, degrees=False) if std > 0 else quantity(value, unit, degrees=False)
        texts.append(f"{name} {number}")
    return ", ".join(texts)


def _worth(trace: CoordinateTrace) -> float:
    """Gain in log evidence for a coordinate [nats]."""
    return trace.final.over(trace.nominal)[0]


def _badge(calibration: Calibration) -> tuple[str, Status]:
    """The verdict as a badge; green only if a single explanation remains."""
    others = {name for effect in calibration.effects for name in effect.tied}
    if calibration.verdict == "explained" and others:
        return f"explained, by one of {len(others) + 1} causes", "fair"
    return _BADGES[calibration.verdict]


def _parameters(calibration: Calibration) -> Table:
    rows: list[tuple[str, ...]] = []
    for effect in calibration.effects:
        for order, (name, value, unit, low, high) in enumerate(effect.rows):
            first = (
                (f"{effect.effect.name} ({effect.effect.coordinate})", plain(effect.evidence))
                if order == 0
                else ("", "")
            )
            sure = interval(low, high, unit) if high > low else "not fitted"
            rows.append((first[0], name, quantity(value, unit), sure, first[1]))
    return Table(("effect", "parameter", "value", "95 % interval", "evidence [nats]"), tuple(rows), numeric=(4,))


def _effect(effect: FoundEffect) -> dict[str, str]:
    """An effect in words; `ambiguity` is empty if it has no alternatives."""
    sentences = [effect.sentence]
    if effect.effect.modes:
        sentences.append(f"It acts only in {', '.join(effect.effect.modes)}.")
    if not effect.is_added:
        sentences.append("The new model does not have it; see the notes.")
    if effect.effect.since is not None:
        sentences.append(f"It began {began(effect.effect.since)}.")
    others = f"This recording does not distinguish it from {', '.join(effect.tied)}. To do so: {effect.experiment}."
    words = {"name": effect.effect.name, "sentences": " ".join(sentences), "source": effect.source}
    return {**words, "ambiguity": others if effect.tied else ""}


def _errors(calibration: Calibration) -> Table:
    head, rows = "root mean square on rows held out from the fit", list[tuple[str, ...]]()
    for error in calibration.errors:
        name, steps = (
            f"{error.of}: " if error.of else "",
            (error.before.one_step, error.after.one_step, error.noise_floor),
        )
        rolls = error.before.rollout, error.after.rollout, error.rollout_floor
        rows.append((f"{name}one step ahead", *(quantity(e, error.unit) for e in steps)))
        rows.append((f"{name}roll-out from the first row", *(quantity(e, error.unit) for e in rolls)))
    return Table((head, "before", "after", "noise alone"), tuple(rows), numeric=(1, 2, 3))


def _poses(calibration: Calibration) -> Table:
    head, rows = "root mean square over all rows, fitted ones included", list[tuple[str, ...]]()
    for what, unit, *sizes in calibration.pose_errors:
        rows.append((f"{what}: one step ahead", *(quantity(size.one_step, unit) for size in sizes)))
        rows.append((f"{what}: roll-out from the first row", *(quantity(size.rollout, unit) for size in sizes)))
    by_evo = [errors for runs in calibration.predicted if runs and (errors := trajectory_errors(runs)) is not None]
    if len(by_evo) == 2:
        names = "APE of roll-outs (evo, translation)", "RPE of roll-outs, from row to row (evo, translation)"
        rows += [
            (name, *(quantity(error, "m") for error in errors))
            for name, errors in zip(names, zip(*by_evo, strict=True), strict=True)
        ]
    return Table((head, "before", "after"), tuple(rows), numeric=(1, 2))


def _correlation(trace: CoordinateTrace) -> Table:
    """Correlations of the fitted parameters' errors; empty for a single parameter."""
    names, matrix = trace.held_out.correlations_of(trace.chosen)
    shown = zip(names, matrix.tolist(), strict=True) if len(names) > 1 else ()
    rows = tuple((name, *(f"{value:.2f}" for value in row)) for name, row in shown)
    return Table(("correlation of errors", *names), rows, numeric=tuple(range(1, len(names) + 1)))


def _coordinate(trace: CoordinateTrace) -> dict[str, Any]:
    """The comparison for one coordinate: charts of errors before and after, evidence of all effects, runs."""
    data = trace.data
    steps, runs = count(int(data.counted.sum()), "step"), count(len(np.unique(data.run)), "run")
    chance = percent(trace.whiteness[1])
    summary = (
        f"{steps} of {runs} were compared; a fifth of {count(len(data.run), 'segment', 'segments')} was held out in "
        f"turn. What remains has an autocorrelation of {plain(trace.whiteness[0], 2)}; noise alone would have so much "
        f"with a probability of {chance}."
    )
    best = [row for row in trace.ranking if row[1] > 0][:_MOST_BARS]
    chosen = {finding.part.name for finding in trace.findings}
    bars = [
        Bar(name, with_spread(gain, error, "nats"), gain / best[0][1], BLUE, faint=name not in chosen)
        for name, gain, error in best
    ]
    charts = {
        "motion": _motion(trace),
        "correlation": _correlation(trace),
        "pairs": _residuals(trace),
        "ranking": Bars("", tuple(bars)),
        "runs": _runs(trace),
    }
    return {"name": data.coordinate, "summary": summary, **charts}


def _runs(trace: CoordinateTrace) -> Table:
    data, held_out = trace.data, trace.held_out
    kinds = [held_out.errors(model, kind) for kind in ("one_step", "rollout") for model in (trace.nominal, trace.final)]
    rows: list[tuple[str, ...]] = []
    for run in np.unique(data.run)[:_MOST_RUNS]:
        chosen = data.counted & (data.run == run)[:, None]
        sizes = [float(np.sqrt(np.mean(errors[chosen] ** 2))) for errors in kinds]
        rows.append((str(run), *(quantity(size, data.unit, degrees=False) for size in sizes)))
    return Table(("run", "one step, before", "after", "roll-out, before", "after"), tuple(rows), numeric=(1, 2, 3, 4))


def motion_charts(calibration: Calibration) -> list[Chart]:
    """One chart per shown run: measured coordinates with predictions before and after, and commands."""
    first, *others = ({chart.x_label: chart for chart in _motion(trace)} for trace in calibration.traces)
    # Where coordinates were not measured in the same runs, the first one is shown.
    together = [run for run in first if all(run in charts for charts in others)]
    others = others if together else []
    return [
        replace(first[run], panels=tuple(panel for of in (first, *others) for panel in of[run].panels))
        for run in together or first
    ]


def _motion(trace: CoordinateTrace) -> tuple[Chart, ...]:
    """Measured motion of some runs with roll-outs before and after, and the commands below.

    First the runs whose roll-outs improved most, then runs evenly over the recording.
    """
    whole = trace.data.whole or trace.data
    counted = whole.counted
    errors = np.zeros((2, *whole.z.shape))
    for number, model in enumerate((trace.nominal, trace.final)):
        errors[number][counted] = trace.held_out.rollout_errors(model)
    before, after = np.sqrt((errors**2).sum(axis=2) / np.maximum(counted.sum(axis=1), 1))
    telling = np.argsort(after - before, kind="stable")[:_MOST_TELLING].tolist() if np.any(before != after) else []
    evenly_chosen = evenly(len(whole.run), _MOST_DRAWN).tolist()
    chosen = [*telling, *(s for s in evenly_chosen if s not in telling)][:_MOST_DRAWN]
    return tuple(_run(whole, s, errors[:, s]) for s in chosen)


def _run(whole: CoordinateData, s: int, errors: Floats) -> Chart:
    rows = np.flatnonzero(whole.counted[s])
    rows = np.array([rows[0] - 1, *rows]) if rows.size else np.arange(2)
    time, z, u = whole.time[s, rows], whole.z[s, rows], whole.u[s, rows]
    before, after = z - errors[0, rows], z - errors[1, rows]
    motion = (
        Curve(time, before, "line", ORANGE, "roll-out before"),
        Curve(time, after, "line", BLUE, "roll-out after"),
        Curve(time, z, "small", INK, "measured"),
    )
    largest = 1.1 * float(np.abs(u).max()) + 1e-9
    command = (Level(0.0, "zero"), Curve(time, u, "trend", INK))
    panels = (
        Panel(f"{whole.coordinate}\n[{whole.unit}]", *widened([z, before, after], 0.05), _HEIGHT, motion),
        Panel(f"command\n[{whole.unit}]", -largest, largest, 0.4 * _HEIGHT, command),
    )
    described = f"{whole.coordinate} in run {whole.run[s]}, measured and predicted"
    return Chart(described, f"time in run {whole.run[s]} [s]", float(time[0]), float(time[-1]) + 1e-9, panels)


def _residuals(trace: CoordinateTrace) -> tuple[tuple[Chart, Chart], ...]:
    """One-step errors before and after against time, configuration, direction and size of the command."""
    data = trace.data
    counted, starts = data.counted, data.counted_starts
    before = trace.held_out.errors(trace.nominal, "one_step")[counted]
    after = trace.held_out.errors(trace.final, "one_step")[counted]
    u = data.u[starts]
    side = np.sign(u) + 0.24 * np.linspace(-1, 1, u.size)
    axes = (
        ("time in the run [s]", data.time[counted]),
        (f"{data.coordinate} [{data.unit}]", data.z[starts]),
        ("direction of the command", side),
        (f"size of the command [{data.unit}]", np.abs(u)),
    )
    reach = float(np.quantile(np.abs(before), _SHARE_SHOWN)) * 1.1 or 1e-9
    names = f"error before\n[{data.unit}]", f"error after\n[{data.unit}]"
    return tuple(
        (_scatter(x, before, names[0], label, reach, ORANGE), _scatter(x, after, names[1], label, reach, BLUE))
        for label, x in axes
    )


def _scatter(x: Floats, y: Floats, y_label: str, x_label: str, reach: float, color: str) -> Chart:
    is_side = x_label.startswith("direction")
    margin = 0.03 * float(np.ptp(x)) or 1e-3
    ends = (-_SIDE, _SIDE) if is_side else (float(x.min()) - margin, float(x.max()) + margin)
    inside = np.clip(y, -reach, reach)
    places = ((-1.0, "backward"), (0.0, "none"), (1.0, "forward")) if is_side else ()
    marks = Level(0.0, "zero"), Curve(x, inside, "small", color), _trend(x, inside)
    panel = Panel(y_label, -reach, reach, _HEIGHT, marks)
    return Chart(f"{y_label} against {x_label}".replace("\n", " "), x_label, *ends, (panel,), places)


def _trend(x: Floats, y: Floats) -> Curve:
    """Means over tenths of the rows, in order of x."""
    order = np.argsort(x, kind="stable")
    groups = [group for group in np.array_split(order, min(12, max(len(order) // 8, 1))) if group.size]
    at = np.array([float(np.median(x[group])) for group in groups])
    mean = np.array([float(np.mean(y[group])) for group in groups])
    return Curve(at, mean, "trend", INK)
