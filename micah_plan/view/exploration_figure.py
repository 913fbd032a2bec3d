"""The figure of an exploration: what force it took, and how sure it became, step by step."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from micah_plan.explore.run import Exploration
from micah_plan.view.exploration_page import KINDS, WORDS
from micah_plan.view.figures import empty_figure
from micah_plan.view.palette import MUTED, PINK


def exploration_figure(found: Exploration) -> Figure:
    """Measured forces against their limit, and the probabilities of what holds the handle."""
    figure = empty_figure((7.0, 4.6), layout="constrained")
    force, kinds = figure.subplots(2, 1, sharex=True)
    steps = np.arange(1, found.steps + 1)
    force.fill_between(steps, [np.linalg.norm(moment.force) for moment in found.moments], color=PINK, alpha=0.5)
    force.axhline(found.scene.largest_force, color=MUTED, ls="--", lw=1, label="limit")
    force.set_ylabel("force [N]")
    shares = [[moment.kinds.get(name, 0.0) for moment in found.moments] for name in KINDS]
    kinds.stackplot(steps, shares, colors=list(KINDS.values()), labels=[WORDS[name] for name in KINDS])
    kinds.set(ylabel="probability", xlabel="step", ylim=(0.0, 1.0))
    for axes in (force, kinds):
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize=9)
    return figure
