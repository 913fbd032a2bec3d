"""What commands print for people: tables and lines of their summaries."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from micah_plan import summaries
from micah_plan.cli.console import out

_LEARNED_COLUMNS = ("mode", "rows", "configuration", "axis", "radius\n\\[m]", "sure", "start\n95 %")


def print_learned(learned: Any, files: tuple[Path | None, ...]) -> None:
    """Table of the segments of every edge."""
    for edge in learned.graph.edges:
        table = Table(*_LEARNED_COLUMNS, box=SIMPLE, padding=(0, 1, 0, 0), title_justify="left")
        table.title = f"{edge.child} relative to {edge.parent}"
        for name in ("mode", "rows", "sure"):
            table.columns[_LEARNED_COLUMNS.index(name)].no_wrap = True
        for segment in edge.segments:
            row = summaries.segment_row(segment)
            table.add_row(*row)
        out.print(table)
        if edge.certainty is not None and edge.certainty.channel is not None:
            out.print(summaries.channel_line(edge.certainty.channel), markup=False)
    if learned.automaton is None:
        out.print(f"no model: {learned.reason}", markup=False, style="yellow")
    else:
        out.print(f"learned {len(learned.automaton.modes)} mode(s) in {learned.seconds:.2f} s")
    print_files(files)


def print_solved(plan: Any, problem: Any, files: tuple[Path | None, ...]) -> None:
    """Outcome and figures of a plan."""
    out.print(f"{plan.outcome}: {plan.reason}", markup=False, style="green" if plan.outcome == "solved" else "yellow")
    if plan.outcome != "solved":
        from micah_plan.planning.explain import explain as explained

        print_lines(explained(problem, plan).lines[1:])
    if plan.trajectory is not None:
        out.print(f"  modes                {' > '.join(plan.mode_sequence)}", markup=False)
        out.print(f"  goal error, std      {plan.goal_error:.4g}, {plan.goal_std:.4g}")
        low, high = plan.success_interval or (0.0, 1.0)
        share = f"{plan.success_probability:.3f} ({low:.3f} to {high:.3f} with 95 %)"
        out.print(f"  success probability  {share} of {plan.verification_trials} roll-outs")
    out.print("  seconds              " + ", ".join(f"{k} {v:.2f}" for k, v in plan.timings.items()))
    print_files(files)


def print_executed(summary: dict[str, Any], files: tuple[Path | None, ...]) -> None:
    """Successes and errors of trials."""
    error = summary["final_error"]
    out.print(f"{summary['successes']} of {summary['trials']} trials reached the goal")
    out.print(f"  final error  {error['mean']:.4g} +- {error['std']:.4g}, at most {error['max']:.4g}")
    for failure in summary["failures"]:
        out.print(f"  trial {failure['trial']}: {failure['reason']}", markup=False)
    print_files(files)


def print_counted(summary: dict[str, Any]) -> None:
    """How many cases a sweep has, and of what."""
    values = [f"{number} of {key}" for key, number in summary["grid"].items()]
    factors = [f"{summary['problems']} problem(s)", *values, f"{summary['seeds']} seed(s)"]
    out.print(f"{summary['cases']:,} cases: {' x '.join(factors)}", markup=False)
    out.print(f"  finished  {summary['finished']:,}")


def print_swept(summary: dict[str, Any], files: tuple[Path, ...]) -> None:
    """What became of the cases of a sweep."""
    before = f", {summary['resumed']:,} of them before" if summary["resumed"] else ""
    out.print(f"finished {summary['cases']:,} cases{before} in {summary['seconds']:.2f} s")
    for outcome, count in summary["outcomes"].items():
        out.print(f"  {outcome:<12} {count:,}")
    if summary["trials"]:
        out.print(f"  {summary['successes']:,} of {summary['trials']:,} trials reached the goal")
    print_files(files)


def print_predicted(summary: dict[str, Any]) -> None:
    """Errors of both predictions beside what noise alone would leave, what they follow, and when modes changed."""
    table = Table("", "position \\[m]", "rotation \\[rad]", "configuration", box=SIMPLE)
    for name, text in (("one_step", "one step"), ("rollout", "roll-out")):
        table.add_row(text, *_three(summary[name]))
        floor = summary["noise_floor"][name]
        table.add_row("  noise alone", *(_three(floor) if floor else ("unknown",) * 3))
    out.print(table)
    out.print(summary["whiteness"]["verdict"], markup=False)
    changes = summary["mode_changes"]
    both = [c["predicted_s"] - c["measured_s"] for c in changes if None not in (c["predicted_s"], c["measured_s"])]
    if changes:
        late = f", on average {sum(both) / len(both):+.3g} s late" if both else ""
        missed = sum(c["predicted_s"] is None for c in changes)
        extra = len(changes) - len(both) - missed
        out.print(f"mode changes: {len(both)} predicted{late}, {missed} measured only, {extra} predicted only")


def _three(values: dict[str, float | None]) -> tuple[str, ...]:
    names = ("position_rmse_m", "rotation_rmse_rad", "configuration_rmse")
    return tuple("not measured" if (value := values[name]) is None else f"{value:.4g}" for name in names)


def print_calibrated(summary: dict[str, Any], changes: Sequence[object], files: tuple[Path | None, ...]) -> None:
    """Verdict, effects and errors of a calibration."""
    table = Table("effect", "parameters", "evidence \\[nats]", "tied with", box=SIMPLE)
    for effect in summary["effects"]:
        units, where = effect["units"], effect["coordinate"]
        values = ", ".join(
            f"{name} {value:.4g} {units[name]}".removesuffix(" 1") for name, value in effect["parameters"].items()
        )
        name = f"{effect['name']} ({where})" + ("" if effect["is_added"] else ", not added")
        table.add_row(name, values, f"{effect['evidence']:.1f}", ", ".join(effect["tied_with"]))
    out.print(f"verdict: {summary['verdict']}", markup=False)
    if summary["effects"]:
        out.print(table)
    residual = summary["residual"]
    for name, text in (("one_step_rmse", "one step"), ("rollout_rmse", "roll-out")):
        out.print(f"  {text:9} {residual['before'][name]:.4g} before, {residual['after'][name]:.4g} after")
    out.print(f"  noise     {residual['noise_floor']:.4g} (one step)")
    out.print(f"  left unexplained: {100 * summary['unexplained_fraction']:.0f} %", markup=False)
    for note in summary["notes"]:
        out.print(f"  note: {note}", markup=False)
    out.print(f"  next: {summary['next_experiment']}", markup=False)
    out.print("changes of the model:" if changes else "the model stays as it is", markup=False)
    print_lines(tuple(f"  {change}" for change in changes))
    print_files(files)


def print_checked(found: Sequence[Any]) -> None:
    """One line per fault and warning, or that there is none."""
    for item in found:
        for fault in item.faults:
            out.print(f"error: {fault}", markup=False, style="red")
        for warning in item.warnings:
            out.print(f"warning: {item.file}: {warning}", markup=False, style="yellow")
        if not item.faults:
            out.print(f"{item.file}: a {item.kind} that can be used", markup=False)


def print_environment(found: Any) -> None:
    """Table of the libraries, what else there is, and advice."""
    out.print(f"micah_plan {found.micah_plan}, Python {found.python}, {found.system}", markup=False)
    table = Table("library", "version", "state", "for", "extra", box=SIMPLE)
    for item in found.libraries:
        library = item.library
        table.add_row(library.name, item.version or "-", item.state, library.purpose, library.extra)
    out.print(table)
    out.print(f"IPOPT solves with: {', '.join(found.linear_solvers) or 'nothing'}", markup=False)
    out.print(f"browser: {found.browser or 'none'}", markup=False)
    for line in found.advice:
        out.print(line, markup=False, style="yellow")


def print_lines(lines: tuple[str, ...]) -> None:
    """Lines as they are."""
    for line in lines:
        out.print(line, markup=False)


def print_files(files: tuple[Path | None, ...]) -> None:
    """What was written."""
    for path in files:
        if path is not None:
            out.print(f"wrote {path}", markup=False)
