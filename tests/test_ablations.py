"""Benchmarks that switch decisions off find each of them by its name in the package."""

from __future__ import annotations

from typing import Any

import pytest
from gates import GATES
from mechanisms import MECHANISMS

_SWITCHES: dict[str, Any] = {**GATES, **MECHANISMS}


@pytest.mark.parametrize("name", _SWITCHES)
def test_switched_off_decision_exists(name: str) -> None:
    assert hasattr(_SWITCHES[name].owner, _SWITCHES[name].attribute)
