"""Simulations that tests of learning share."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def cycles() -> ModuleType:
    """The benchmark of parts that are opened and shut, whose simulation uses nothing of the learner."""
    folder = str(Path(__file__).parents[2] / "benchmarks")
    sys.path.insert(0, folder)
    try:
        import cycles

        return cycles
    finally:
        sys.path.remove(folder)
