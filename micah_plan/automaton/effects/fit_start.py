"""Data of one coordinate, and the starting values that a form proposes for a fit to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from micah_plan.arrays import ROUND_OFF, Booleans, Floats

if TYPE_CHECKING:
    from micah_plan.automaton.link_motion import LinkMotion

# Commands smaller than this share of the usual one are rest.
_AT_REST = 1e-3


class CoordinateSeries(Protocol):
    """One coordinate over S segments of up to T rows; calibration's `coordinate_data.CoordinateData` is one.

    Attributes:
        unit: rad or m. z, u: (S, T) measured configuration, and commanded displacement from each row to the next.
        counted, counted_starts: (S, T) whether the step to, or from, a row counts.
        action: (S, T, 3) recorded displacement [m], None if there is none of this part alone; path: measured
            configurations.
        lower, upper: ends of the range, infinite where there is none; clings: whether the part may cling to them.
        visited: smallest and largest measured configuration; command_size: root mean square of the commands.
        period: from row to row [s].
    """

    @property
    def unit(self) -> str: ...
    @property
    def z(self) -> Floats: ...
    @property
    def u(self) -> Floats: ...
    @property
    def counted(self) -> Booleans: ...
    @property
    def counted_starts(self) -> Booleans: ...
    @property
    def action(self) -> Floats | None: ...
    @property
    def path(self) -> LinkMotion: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...
    @property
    def clings(self) -> tuple[bool, bool]: ...
    @property
    def visited(self) -> tuple[float, float]: ...
    @property
    def command_size(self) -> float: ...
    @property
    def period(self) -> float: ...

    def visits_end(self) -> bool:
        """Whether the recording gets to an end of the range."""
        ...


@dataclass(frozen=True, eq=False)
class FitStart:
    """Starting values of a fit, of which the best is refined.

    Attributes:
        values: (M, parameters) all parameters of each start; fixed ones differ between starts only.
        free: columns that are fitted.
        scale: a large value of each free parameter.
        bounds: (lower, upper) of columns that the recording bounds more than the form does: beyond them it would be
            another effect (a spring whose rest position is far away is a bias).
    """

    values: Sequence[Sequence[float]] | Floats
    free: tuple[int, ...]
    scale: Sequence[float]
    bounds: Mapping[int, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class EquivalentEffect:
    """An equivalent effect on a recording, if its first parameter is below a bound."""

    name: str
    below: float = float("inf")


def step_sizes(data: CoordinateSeries, *shares: float) -> list[float]:
    """Quantiles of the sizes of measured steps [rad or m]; empty if there was no motion."""
    sizes = np.abs(np.diff(data.z, axis=1)[data.counted_starts[:, :-1]])
    return [float(q) for q in np.quantile(sizes, shares) if q > ROUND_OFF] if sizes.size else []


def command_sizes(data: CoordinateSeries, *shares: float) -> list[float]:
    """Quantiles of the sizes of nonzero commands [rad or m]; empty if there are none."""
    sizes = np.abs(data.u[data.counted_starts])
    sizes = sizes[sizes > _AT_REST * data.command_size]
    return [float(q) for q in np.quantile(sizes, shares)] if sizes.size else []
