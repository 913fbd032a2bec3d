"""The page of a calibration: what was compared, what is missing, how sure that is, what remains, what to do next."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from micah_plan.residual.calibrate import Calibration, FoundEffect
from micah_plan.residual.trace import LaneTrace
from micah_plan.view.calibration_charts import ranking_chart, residual_charts

_SENTENCES = {
    "none": "Nothing is missing that this recording can show.",
    "explained": "The named effects explain what the model missed.",
    "partly": "The named effects explain a part of what the model missed.",
    "unexplained": "Something is missing that no effect of the library explains.",
}
_MOST_RUNS = 60
_STYLE = """
:root { color-scheme: light dark; --ink: #1f2933; --muted: #5b6770; --line: #c3ccd5; --page: #fff; --bar: #9aa5b1; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaee; --muted: #a7b1bb; --line: #46525e; --page: #171c21; --bar: #6b7783; }
}
body { font: 16px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--page); margin: 2rem auto;
  max-width: 46rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0; } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; }
.badge { display: inline-block; border: 1px solid var(--line); border-radius: 1rem; padding: .1rem .8rem; }
.badge.explained, .badge.none { border-color: #009e73; } .badge.partly { border-color: #e69f00; }
.badge.unexplained { border-color: #d55e00; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; } .wide { overflow-x: auto; }
th, td { text-align: left; padding: .25rem .6rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
.pair { display: flex; flex-wrap: wrap; gap: .5rem; } .pair svg { flex: 1 1 300px; min-width: 0; }
svg { width: 100%; height: auto; } svg text { font: 11px system-ui, sans-serif; fill: var(--muted); }
svg .mid { text-anchor: middle; } svg .end { text-anchor: end; } svg .frame { fill: none; stroke: var(--line); }
svg .zero { stroke: var(--line); fill: none; } svg .trend { stroke: var(--ink); stroke-width: 1.6; fill: none; }
svg .dots { stroke: var(--tint); stroke-width: 3; stroke-linecap: round; opacity: .55; fill: none; }
svg .bar { fill: var(--bar); } svg .bar.chosen { fill: #0072b2; }
.note { color: var(--muted); }
"""


def calibration_page(found: Calibration, title: str) -> str:
    """The page as HTML text: self-contained, fetches nothing, the same value gives the same bytes."""
    body = [
        f"<h1>{escape(title)}</h1>",
        '<p class="note">calibration: measured motion against the model</p>',
        f'<p class="badge {found.verdict}">{found.verdict}</p> {escape(_SENTENCES[found.verdict])}',
        *(f'<p class="note">{escape(note)}</p>' for note in found.notes),
        *_missing_modes(found),
        *_effects(found),
        *_errors(found),
    ]
    for one in found.traces:
        body += _coordinate(one)
    body += ["<h2>What next</h2>", f"<p>{escape(_capital(found.experiment))}.</p>"]
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; "
            'img-src data:">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<title>{escape(title)} (calibration)</title><link rel="icon" href="data:,">',
            f"<style>{_STYLE}</style></head><body>",
            *body,
            "</body></html>",
            "",
        ]
    )


def _missing_modes(found: Calibration) -> list[str]:
    modes = [mode for one in found.traces for mode in one.missing_modes]
    if not modes:
        return []
    told = [
        f"<p>{escape(_capital(str(mode)))}. Evidence over any gradual change: {mode.evidence:.0f} nats.</p>"
        for mode in modes
    ]
    return ["<h2>Modes that are missing</h2>", *told]


def _effects(found: Calibration) -> list[str]:
    if not found.effects:
        return []
    rows = [row for effect in found.effects for row in _effect_rows(effect)]
    head = ("effect", "parameter", "value", "95 % interval", "evidence [nats]")
    parts = ["<h2>What is missing</h2>", _table(head, rows, numeric=(4,))]
    for effect in found.effects:
        sentence = f"<p><b>{escape(effect.effect.name)}</b>: {escape(effect.sentence)}"
        if effect.effect.modes:
            sentence += escape(f" It acts only in {', '.join(effect.effect.modes)}.")
        if not effect.is_added:
            sentence += " It makes the roll-out worse, so the new model does not have it."
        if effect.since is not None:
            sentence += escape(f" It was seen from run {effect.since[0]}, {effect.since[1]:.3g} s on.")
        sentence += f' <span class="note">Source: {escape(effect.source)}.</span></p>'
        parts.append(sentence)
        if effect.tied:
            told = f"This recording cannot tell it from {', '.join(effect.tied)}. To tell: {effect.experiment}."
            parts.append(f"<p>{escape(told)}</p>")
    return parts


def _effect_rows(effect: FoundEffect) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    zipped = zip(effect.effect.parameters, effect.units, effect.interval, strict=True)
    for number, ((name, value), unit, (low, high)) in enumerate(zipped):
        first = number == 0
        shown = "" if unit == "1" else unit
        interval = f"{low:.4g} to {high:.4g}" if high > low else "chosen"
        head = f"{effect.effect.name} ({effect.effect.coordinate})" if first else ""
        rows.append((head, name, f"{value:.4g} {shown}".rstrip(), interval, f"{effect.evidence:.1f}" if first else ""))
    return rows


def _errors(found: Calibration) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ("one step", f"{found.before.one_step:.4g}", f"{found.after.one_step:.4g}", f"{found.noise_floor:.4g}"),
        ("roll-out", f"{found.before.rollout:.4g}", f"{found.after.rollout:.4g}", ""),
    ]
    left = f"Of the error that can be explained, {100 * found.unexplained_fraction:.0f} % has no name."
    return [
        "<h2>Errors on rows held out from the fit</h2>",
        _table(("root mean square [rad or m]", "before", "after", "noise floor"), rows, numeric=(1, 2, 3)),
        f"<p>{left}</p>",
    ]


def _coordinate(one: LaneTrace) -> list[str]:
    lane = one.lane
    parts = [f"<h2>{escape(lane.coordinate)}</h2>"]
    compared = (
        f"{int(lane.counted.sum())} steps of {len(np.unique(lane.run))} run(s) were compared, in "
        f"{len(lane.run)} stretches of which a fifth was held out in turn."
    )
    white = f"What remains has an autocorrelation of {one.correlation:.2f} (p = {one.white_probability:.2g} if white)."
    parts += [f"<p>{escape(compared)} {escape(white)}</p>", residual_charts(one), "<h3>Candidates, each alone</h3>"]
    return [*parts, ranking_chart(one), "<h3>Run by run</h3>", _runs(one)]


def _runs(one: LaneTrace) -> str:
    lane, search = one.lane, one.search
    kinds = [search.errors(model, kind) for kind in ("one_step", "rollout") for model in (one.nominal, one.final)]
    rows: list[tuple[str, ...]] = []
    for run in np.unique(lane.run)[:_MOST_RUNS]:
        chosen = lane.counted & (lane.run == run)[:, None]
        rows.append((str(run), *(f"{float(np.sqrt(np.mean(errors[chosen] ** 2))):.4g}" for errors in kinds)))
    head = ("run", "one step before", "after", "roll-out before", "after")
    return _table(head, rows, numeric=(1, 2, 3, 4))


def _table(head: Iterable[str], rows: Iterable[tuple[str, ...]], numeric: tuple[int, ...]) -> str:
    def cells(row: Iterable[str], tag: str) -> str:
        return "".join(
            f"<{tag}{' class=n' if i in numeric else ''}>{escape(cell)}</{tag}>" for i, cell in enumerate(row)
        )

    lines = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{cells(head, "th")}</tr>{lines}</table></div>'


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
