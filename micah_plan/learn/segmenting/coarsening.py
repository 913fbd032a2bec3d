"""How far a likelihood is to be trusted: the power that it counts with.

No hinge is ideal and no tracker errs as a noise model says. Where noise is far below such misfits, rows claim
more than they know, and the smallest systematic deviation, recorded long enough, would become a second joint. Where
noise is far above them, misfits do not show, and a row tells what the noise model says.

Source: Miller and Dunson, "Robust Bayesian inference via coarsening", JASA 2019.
"""

from __future__ import annotations

import numpy as np

from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.settings import LearnSettings

LEAST_TRUST = 0.5


def trust_in(noise: NoiseModel, settings: LearnSettings) -> float:
    """Power of the likelihood, from 0.5 (misfits rule) to 1 (noise rules).

    Args:
        noise: as the roughness of the rows tells it, so that all answers for a track are judged with one power.
    """
    if settings.trust is not None:
        return settings.trust
    whites = noise.white[0].reshape(-1, 3).mean(axis=1)
    misfits = [settings.rotation_misfit, settings.position_misfit][-len(whites) :]
    shares = whites / (whites + np.square(misfits))
    return float(LEAST_TRUST + (1 - LEAST_TRUST) * shares.mean())
