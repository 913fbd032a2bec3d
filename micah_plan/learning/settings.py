"""Settings of model learning, one default for all recordings; None is estimated from the data."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from micah_plan.automaton.joint import SCREW_KINDS, JointKind
from micah_plan.errors import InputError, shown

# Rows that a run needs of each of its parts: fewer cannot separate joints from noise.
FEWEST_ROWS = 5


@dataclass(frozen=True)
class LearnSettings:
    """Assumptions of the learner.

    Attributes:
        kinds: candidate joints of a constant twist.
        paths: whether a part without such a joint that follows one curve repeatedly moves along a path.
        position_std, rotation_std: white noise of one pose measurement [m, rad]; None: estimated from the rows.
        position_wander, rotation_wander: std of the tracker's slowly wandering error [m, rad].
        wander_durations: time over which that error forgets, in durations of the run, which makes the result
            independent of the sampling rate and of the unit of time.
        position_misfit, rotation_misfit: how far real joints and trackers deviate from models [m, rad]; the smaller the
            noise is against this, the less a row counts, and the covariance of joints expects deviations of about that
            size.
        likelihood_power: power of the likelihood; None: from the noise and these deviations, one power for all parts.
        mean_length: expected duration of a segment [s]; None: half the run.
        length_shape: shape of the length prior (a gamma distribution); 1 is memoryless, more makes short segments
            rarer.
        rest: prior probability that a part on a moving joint rests in a step, where actions are uninformative.
        outlier_weight: w of the outlier prior p(γ) ∝ exp(-w γ).
        window: most rows of a window, where a long run or rows that still come in are learned.
        resolution: steps to which rows are averaged while the part moves once through its range; changepoints are then
            refined to the row, and joints are fitted to all rows.
        sweeps: how often the part moves there and back, for the number of steps of a run that is learned at once; None:
            estimated from the rows, and frequent motion is learned in windows.
    """

    kinds: tuple[JointKind, ...] = SCREW_KINDS
    paths: bool = True
    position_std: float | None = None
    rotation_std: float | None = None
    position_wander: float = 0.004
    rotation_wander: float = 0.08
    wander_durations: float = 1.5
    position_misfit: float = 0.002
    rotation_misfit: float = 0.02
    likelihood_power: float | None = None
    mean_length: float | None = None
    length_shape: float = 2.0
    rest: float = 0.2
    outlier_weight: float = 10.0
    window: int = 4096
    resolution: int = 64
    sweeps: float | None = None

    def __post_init__(self) -> None:
        if not self.kinds or any(kind not in SCREW_KINDS for kind in self.kinds):
            raise InputError(f"LearnSettings.kinds must be among {SCREW_KINDS}. Got {shown(self.kinds)}")
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name not in ("kinds", "paths") and value is not None and not value > 0:
                raise InputError(f"LearnSettings.{item.name} must be positive. Got {shown(value)}")

    def of_steps(self, rows: float) -> LearnSettings:
        """The assumptions for means of so many rows: a given white noise is averaged."""
        share = rows**-0.5
        return replace(
            self,
            position_std=None if self.position_std is None else self.position_std * share,
            rotation_std=None if self.rotation_std is None else self.rotation_std * share,
        )
