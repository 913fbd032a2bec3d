"""The page of a calibration: what was compared, what the model lacks, how sure that is, what remains, what is next."""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.quantities import count, interval, listed, percent, plain, quantity, with_spread
from micah_plan.residual.calibrate import Calibration, FoundEffect
from micah_plan.residual.lane import Lane
from micah_plan.residual.trace import LaneTrace
from micah_plan.residual.verdict import SENTENCES, Verdict
from micah_plan.view.learned import capital
from micah_plan.view.page import Bar, Bars, Status, Table, render
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.svg import Panel, Svg, drawing, evenly

_BADGES: dict[Verdict, tuple[str, Status]] = {
    "none": ("nothing is missing", "good"),
    "explained": ("explained", "good"),
    "partly": ("explained in part", "fair"),
    "unexplained": ("not explained", "bad"),
}
_MOST_RUNS, _MOST_BARS, _MOST_DRAWN = 60, 12, 4
_WIDTH, _HEIGHT = 400.0, 140.0
_LEFT, _RIGHT, _TOP = 66.0, 10.0, 10.0
_SHARE_SHOWN = 0.995
_SIGMAS = 1.96
"""From the middle of a 95 % interval to its ends."""
_SIDE = 1.5
"""Where the axis of directions ends: dots of commands forward lie around 1, those backward around -1."""


def calibration_page(found: Calibration, title: str) -> str:
    """The page as HTML text: self-contained, fetches nothing, the same value gives the same bytes."""
    modes = [mode for one in found.traces for mode in one.missing_modes]
    gain = "It predicts {} nats better than any gradual change."
    coordinates = [_coordinate(one) for one in found.traces]
    page = {
        "title": f"{listed([one.lane.coordinate for one in found.traces])}: measured motion against the model",
        "kind": f"calibration with {title}",
        "badge": _badge(found),
        "headline": _headline(found),
        "message": SENTENCES[found.verdict],
        "notes": found.notes,
        "modes": [f"{capital(str(mode))}. {gain.format(plain(mode.evidence))}" for mode in modes],
        "parameters": _parameters(found),
        "effects": [_effect(one) for one in found.effects],
        "errors": _errors(found),
        "poses": _poses(found),
        "unexplained": f"Left unexplained: {percent(found.unexplained_fraction, 0)} of the error that could be "
        "explained.",
        "coordinates": coordinates,
        "first": coordinates[max(range(len(coordinates)), key=lambda k: _worth(found.traces[k]))]["motion"][:2],
        "experiment": f"{capital(found.experiment)}.",
    }
    return render("calibration.html.j2", page=page)


def _headline(found: Calibration) -> str:
    """What was found and what it is worth, in a sentence or two."""
    runs = count(len(found.recording.runs), "run")
    added = [one for one in found.effects if one.is_added]
    changes = []
    for own in found.errors:
        of = f" of {own.of}" if own.of else ""
        for what, name in (("roll-outs", "rollout"), ("single steps", "one_step")):
            before, after = (quantity(getattr(size, name), own.unit) for size in (own.before, own.after))
            changes.append(f"{what}{of} from {before} to {after}" if added else f"{before} in {what}{of}")
    if not added:
        return f"Over {runs} the model misses by {listed(changes)}."
    named = listed([f"{one.effect.name} ({_values(one)})" for one in added])
    return f"Over {runs}: {named}. Errors on rows that no fit saw: {listed(changes)}."


def _values(one: FoundEffect) -> str:
    """The parameters of an effect, each with its spread where it was fitted."""
    texts = []
    for (name, value), unit, (low, high) in zip(one.effect.parameters, one.units, one.interval, strict=True):
        std = (high - low) / (2.0 * _SIGMAS)
        number = with_spread(value, std, unit, degrees=False) if std > 0 else quantity(value, unit, degrees=False)
        texts.append(f"{name} {number}")
    return ", ".join(texts)


def _worth(one: LaneTrace) -> float:
    """How much better the model became for a coordinate [nats]."""
    return one.final.over(one.nominal)[0]


def _badge(found: Calibration) -> tuple[str, Status]:
    """The verdict; green only if the recording leaves one explanation."""
    others = {name for one in found.effects for name in one.tied}
    if found.verdict == "explained" and others:
        return f"explained, by one of {len(others) + 1} causes", "fair"
    return _BADGES[found.verdict]


def _parameters(found: Calibration) -> Table:
    rows: list[tuple[str, ...]] = []
    for one in found.effects:
        values = zip(one.effect.parameters, one.units, one.interval, strict=True)
        for order, ((name, value), unit, (low, high)) in enumerate(values):
            first = (f"{one.effect.name} ({one.effect.coordinate})", plain(one.evidence)) if order == 0 else ("", "")
            sure = interval(low, high, unit) if high > low else "not fitted"
            rows.append((first[0], name, quantity(value, unit), sure, first[1]))
    return Table(("effect", "parameter", "value", "95 % interval", "evidence [nats]"), tuple(rows), (4,))


def _effect(found: FoundEffect) -> dict[str, str]:
    """An effect in words; `ambiguity` is empty if no other effect explains the recording as well."""
    sentences = [found.sentence]
    if found.effect.modes:
        sentences.append(f"It acts only in {', '.join(found.effect.modes)}.")
    if not found.is_added:
        sentences.append("It makes the roll-out worse, so the new model does not have it.")
    if found.since is not None:
        run, time = found.since
        sentences.append(f"It is seen from {quantity(time, 's')} into run {run}.")
    others = f"This recording does not distinguish it from {', '.join(found.tied)}. To do so: {found.experiment}."
    words = {"name": found.effect.name, "sentences": " ".join(sentences), "source": found.source}
    return {**words, "ambiguity": others if found.tied else ""}


def _errors(found: Calibration) -> Table:
    head, rows = "root mean square on rows held out from the fit", list[tuple[str, ...]]()
    for own in found.errors:
        name, steps = f"{own.of}: " if own.of else "", (own.before.one_step, own.after.one_step, own.noise_floor)
        rolls = own.before.rollout, own.after.rollout, own.rollout_floor
        rows.append((f"{name}one step ahead", *(quantity(e, own.unit) for e in steps)))
        rows.append((f"{name}roll-out from the first row", *(quantity(e, own.unit) for e in rolls)))
    return Table((head, "before", "after", "noise alone"), tuple(rows), (1, 2, 3))


def _poses(found: Calibration) -> Table:
    head, rows = "root mean square over all rows, fitted ones included", list[tuple[str, ...]]()
    for what, unit, *sizes in found.pose_errors:
        rows.append((f"{what}: one step ahead", *(quantity(size.one_step, unit) for size in sizes)))
        rows.append((f"{what}: roll-out from the first row", *(quantity(size.rollout, unit) for size in sizes)))
    return Table((head, "before", "after"), tuple(rows), (1, 2))


def _correlation(one: LaneTrace) -> Table:
    """How the errors of fitted parameters go together; empty for a single one."""
    names, matrix = one.search.correlations_of(one.chosen)
    shown = zip(names, matrix.tolist(), strict=True) if len(names) > 1 else ()
    rows = tuple((name, *(f"{value:.2f}" for value in row)) for name, row in shown)
    return Table(("correlation of errors", *names), rows, tuple(range(1, len(names) + 1)))


def _coordinate(one: LaneTrace) -> dict[str, Any]:
    """What was compared of one coordinate: charts of errors before and after, evidence of every effect, runs."""
    lane = one.lane
    steps, runs = count(int(lane.counted.sum()), "step"), count(len(np.unique(lane.run)), "run")
    chance = percent(one.whiteness[1])
    summary = (
        f"{steps} of {runs} were compared; a fifth of {count(len(lane.run), 'stretch', 'stretches')} was held out in "
        f"turn. What remains has an autocorrelation of {plain(one.whiteness[0], 2)}; noise alone would have so much "
        f"with a probability of {chance}."
    )
    best = [row for row in one.ranking if row[1] > 0][:_MOST_BARS]
    chosen = {finding.part.name for finding in one.findings}
    bars = [
        Bar(name, with_spread(gain, error, "nats"), gain / best[0][1], BLUE, faint=name not in chosen)
        for name, gain, error in best
    ]
    charts = {
        "motion": _motion(one),
        "correlation": _correlation(one),
        "pairs": _residuals(one),
        "ranking": Bars("", tuple(bars)),
        "runs": _runs(one),
    }
    return {"name": lane.coordinate, "summary": summary, **charts}


def _runs(one: LaneTrace) -> Table:
    lane, search = one.lane, one.search
    kinds = [search.errors(model, kind) for kind in ("one_step", "rollout") for model in (one.nominal, one.final)]
    rows: list[tuple[str, ...]] = []
    for run in np.unique(lane.run)[:_MOST_RUNS]:
        chosen = lane.counted & (lane.run == run)[:, None]
        sizes = [float(np.sqrt(np.mean(errors[chosen] ** 2))) for errors in kinds]
        rows.append((str(run), *(quantity(size, lane.unit, degrees=False) for size in sizes)))
    return Table(("run", "one step, before", "after", "roll-out, before", "after"), tuple(rows), (1, 2, 3, 4))


def _motion(one: LaneTrace) -> tuple[Svg, ...]:
    """Measured motion of some runs, roll-outs of it before and after, and the commands below."""
    whole = one.lane.whole or one.lane
    counted = whole.counted
    errors = np.zeros((2, *whole.z.shape))
    for number, model in enumerate((one.nominal, one.final)):
        errors[number][counted] = one.search.rollout_errors(model)
    return tuple(_run(whole, s, errors[:, s]) for s in evenly(len(whole.run), _MOST_DRAWN).tolist())


def _run(whole: Lane, s: int, errors: Floats) -> Svg:
    rows = np.flatnonzero(whole.counted[s])
    rows = np.array([rows[0] - 1, *rows]) if rows.size else np.arange(2)
    time, z, u = whole.time[s, rows], whole.z[s, rows], whole.u[s, rows]
    before, after = z - errors[0, rows], z - errors[1, rows]
    low, high = (float(end) for end in (min(map(np.min, (z, before, after))), max(map(np.max, (z, before, after)))))
    room, largest = 0.05 * (high - low) + 1e-9, 1.1 * float(np.abs(u).max()) + 1e-9
    ends = float(time[0]), float(time[-1]) + 1e-9
    panel = Panel(_LEFT, _TOP, _WIDTH - _LEFT - _RIGHT, _HEIGHT, *ends, low - room, high + room)
    told = panel.below(12.0, 0.4 * _HEIGHT, -largest, largest)
    parts = [
        panel.frame,
        panel.curve(time, before, "run chosen", ORANGE),
        panel.curve(time, after, "run chosen", BLUE),
        panel.curve(time, z, "dots small", INK, dots=True),
        panel.y_axis(f"{whole.coordinate}\n[{whole.unit}]"),
        told.frame,
        told.level(0.0, "zero"),
        told.curve(time, u, "trend"),
        told.y_axis(f"command\n[{whole.unit}]", 2),
        told.x_axis(f"time in run {whole.run[s]} [s]", whole=False),
    ]
    return drawing(_WIDTH, [panel, told], parts, f"{whole.coordinate} in run {whole.run[s]}, measured and predicted")


def _residuals(one: LaneTrace) -> tuple[tuple[Svg, Svg], ...]:
    """One-step errors before and after against time, configuration, direction and size of the command."""
    lane = one.lane
    counted, starts = lane.counted, lane.counted_starts
    before = one.search.errors(one.nominal, "one_step")[counted]
    after = one.search.errors(one.final, "one_step")[counted]
    u = lane.u[starts]
    side = np.sign(u) + 0.24 * np.linspace(-1, 1, u.size)
    axes = (
        ("time in the run [s]", lane.time[counted]),
        (f"{lane.coordinate} [{lane.unit}]", lane.z[starts]),
        ("direction of the command", side),
        (f"size of the command [{lane.unit}]", np.abs(u)),
    )
    reach = float(np.quantile(np.abs(before), _SHARE_SHOWN)) * 1.1 or 1e-9
    names = f"error before\n[{lane.unit}]", f"error after\n[{lane.unit}]"
    return tuple(
        (_scatter(x, before, names[0], label, reach, ORANGE), _scatter(x, after, names[1], label, reach, BLUE))
        for label, x in axes
    )


def _scatter(x: Floats, y: Floats, y_label: str, x_label: str, reach: float, color: str) -> Svg:
    is_side = x_label.startswith("direction")
    margin = 0.03 * float(np.ptp(x)) or 1e-3
    ends = (-_SIDE, _SIDE) if is_side else (float(x.min()) - margin, float(x.max()) + margin)
    panel = Panel(_LEFT, _TOP, _WIDTH - _LEFT - _RIGHT, _HEIGHT, *ends, -reach, reach)
    inside = np.clip(y, -reach, reach)
    sides = ((-1.0, "backward"), (0.0, "none"), (1.0, "forward"))
    parts = [
        panel.frame,
        panel.level(0.0, "zero"),
        panel.curve(x, inside, "dots small", color, dots=True),
        _trend(panel, x, inside),
        panel.y_axis(y_label),
        panel.named_x_axis(x_label, sides) if is_side else panel.x_axis(x_label, 5, whole=False),
    ]
    return drawing(_WIDTH, [panel], parts, f"{y_label} against {x_label}".replace("\n", " "))


def _trend(panel: Panel, x: Floats, y: Floats) -> Svg:
    """Means over tenths of the rows, in order of x."""
    order = np.argsort(x, kind="stable")
    groups = [group for group in np.array_split(order, min(12, max(len(order) // 8, 1))) if group.size]
    at = np.array([float(np.median(x[group])) for group in groups])
    mean = np.array([float(np.mean(y[group])) for group in groups])
    return panel.curve(at, mean, "trend")
