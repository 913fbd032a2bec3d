"""Sweeps: problems x values of their keys x seeds, and one case of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

from micah_plan import __version__
from micah_plan.task.plants import DEFAULT_PLANT, PlantName

MOST_CASES = 100_000
Digests = Mapping[str, str]


@dataclass(frozen=True)
class Case:
    """A problem with some of its values replaced, to be solved with one seed and perhaps executed.

    Attributes:
        problem: as the sweep names it.
        path: of the problem file, absolute; a worker on another machine must see it there.
        digests: SHA-256 of the files that the case is made of, by role.
        overrides: (dotted key, plain value) in the order of the grid.
        seed: of planning and of the trials.
        plant, trials: where the plan is executed and how often; 0 trials: it is only solved.
    """

    problem: str
    path: Path
    digests: Digests
    overrides: tuple[tuple[str, Any], ...]
    seed: int
    plant: PlantName = DEFAULT_PLANT
    trials: int = 0

    @cached_property
    def key(self) -> str:
        """Hash of everything that the result depends on; paths and names of files are excluded."""
        content = {
            "micah_plan": __version__,
            "digests": dict(self.digests),
            "overrides": dict(self.overrides),
            "seed": self.seed,
            "execute": [self.plant, self.trials] if self.trials else None,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class SweptProblem:
    """A problem of a sweep.

    Attributes:
        name: as the sweep names it.
        path: of the file, absolute.
        digests: SHA-256 of its files, by role.
        value_digests: of the files that are others with a value of the grid, by (dotted key, number of the value).
    """

    name: str
    path: Path
    digests: Digests
    value_digests: Mapping[tuple[str, int], Digests] = field(default_factory=dict)


@dataclass(frozen=True)
class Sweep:
    """Every problem with every combination of the grid's values and every seed.

    Attributes:
        problems: at least one.
        grid: (dotted key of the problem file, its values); empty: the problems as they are.
        seeds: of planning and of the trials.
        plant, trials: where plans are executed and how often; 0 trials: they are only solved.
        source: the file; empty if made in Python.
    """

    problems: tuple[SweptProblem, ...]
    grid: tuple[tuple[str, tuple[Any, ...]], ...] = ()
    seeds: range = range(1)
    plant: PlantName = DEFAULT_PLANT
    trials: int = 0
    source: str = ""

    def __len__(self) -> int:
        return len(self.problems) * prod(len(values) for _, values in self.grid) * len(self.seeds)

    def cases(self) -> Iterator[Case]:
        """All cases in the order of the table: problems, then the grid with its last key changing first, then seeds."""
        keys = [key for key, _ in self.grid]
        for problem in self.problems:
            for chosen in product(*(enumerate(values) for _, values in self.grid)):
                digests = dict(problem.digests)
                for key, (number, _) in zip(keys, chosen, strict=True):
                    digests |= problem.value_digests.get((key, number), {})
                overrides = tuple((key, value) for key, (_, value) in zip(keys, chosen, strict=True))
                for seed in self.seeds:
                    yield Case(problem.name, problem.path, digests, overrides, seed, self.plant, self.trials)
