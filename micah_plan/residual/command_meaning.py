"""Meaning of commands where the recording does not state it: displacements or positions.

A recorded action is the same in both cases: the commanded place relative to the measured pose. But with places, the
part makes up for what it missed before; with displacements it does not. Both meanings are compared by their predictions
of the motion. The meaning is also visible in the commands alone, since measurement noise enters the other sequence:
true places (or displacements) form the smoother one. That decides where both predict equally well (a part that follows
exactly, without noise), and counts against places that predict only slightly better, as measured poses do where the
tracker's noise wanders.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import earlier_rows
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import robust_log_density

CONTAINED = {
    "follow": ("gain", "bias", "delay", "lag", "dead_zone", "spring", "saturation", "ramp", "drive"),
    "drive": ("gain", "delay", "lag", "dead_zone", "direction_gain"),
}
"""Names of whole machines, told places or speeds, and of the effects that each has in itself."""
# Commands before one that its regularity is judged by.
_MEMORY = 2
# Degrees of freedom of the unpredicted part: a few jumps decide nothing.
_FREEDOM = 2.0


def regularity(data: CoordinateData) -> float:
    """Log-density gain of an autoregression on commanded positions over one on displacements [nats].

    Measurement noise enters the displacement that leads to a commanded place, and the place that a commanded
    displacement leads to.
    """
    whole = data.whole or data
    # Commands of rows without a measurement are as regular as the others.
    starts = whole.counted_starts if whole.segment is None else earlier_rows(whole.segment >= 0, -1)
    starts[:, :_MEMORY] = False
    if starts.sum() <= _MEMORY + 1:
        return 0.0
    forms = []
    for series in (whole.u, whole.place):
        before = [earlier_rows(series, k + 1)[starts] for k in range(_MEMORY)]
        now = series[starts]
        design = np.stack([np.ones(len(now)), *before], axis=1)
        forms.append(robust_log_density(design, now, _FREEDOM))
    return forms[1] - forms[0]
