"""Likelihood power: tempering of the likelihood by the suspected misfit of the model.

No hinge is ideal and no tracker's errors follow a noise model exactly. Where noise is far below such misfits, the
likelihood of rows is overconfident, and the smallest systematic deviation, recorded long enough, would become a second
joint. Where noise is far above them, misfits do not matter, and the noise model holds.

Source: Miller and Dunson, "Robust Bayesian inference via coarsening", JASA 2019.
"""

from __future__ import annotations

import numpy as np

from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.settings import LearnSettings

LEAST_LIKELIHOOD_POWER = 0.5


def likelihood_power_of(noise: NoiseModel, settings: LearnSettings) -> float:
    """Power of the likelihood, from 0.5 (misfits rule) to 1 (noise rules).

    Args:
        noise: estimated from the roughness of the rows, so that all hypotheses for a track are judged with one power.
    """
    if settings.likelihood_power is not None:
        return settings.likelihood_power
    whites = noise.white[0].reshape(-1, 3).mean(axis=1)
    misfits = [settings.rotation_misfit, settings.position_misfit][-len(whites) :]
    shares = whites / (whites + np.square(misfits))
    return float(LEAST_LIKELIHOOD_POWER + (1 - LEAST_LIKELIHOOD_POWER) * shares.mean())
