"""Fixtures that several test folders share."""

from __future__ import annotations

import os
from pathlib import Path

# Before NumPy is loaded: as the commands, tests run on a core each. Set it to another number to try others.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from extras import skip_without
from hypothesis import HealthCheck, settings

REPOSITORY = Path(__file__).resolve().parents[1]

# No test measures the machine, and one commit gives one result: no time limits, the same examples every time.
# `pytest --hypothesis-profile=evidence` draws new ones.
_UNTIMED = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture)
settings.register_profile("evidence", deadline=None, suppress_health_check=_UNTIMED)
settings.register_profile("gate", settings.get_profile("evidence"), derandomize=True)
settings.load_profile("gate")


@pytest.hookimpl(tryfirst=True)  # before -m chooses by the marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    swept = set[tuple[object, ...]]()
    for item in items:
        if item.get_closest_marker("sweep") is None:
            continue
        function = (item.path, item.parent and item.parent.nodeid, getattr(item, "originalname", item.name))
        if function in swept and item.get_closest_marker("evidence") is None:
            item.add_marker(pytest.mark.slow)
        swept.add(function)


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("requires_extra"):
        skip_without(mark.kwargs["name"])


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the source tree."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured recordings, which the project does not ship: next to the repository or at MICAH_DATA."""
    folder = Path(os.environ.get("MICAH_DATA") or REPOSITORY.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"measured recordings are not at {folder}; set MICAH_DATA to where they are")
    return folder
