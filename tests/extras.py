"""The one rule for tests that need an optional extra of ``pyproject.toml``.

Such a test carries the mark `requires` (or its module begins with `module_requires`). Where the extra is not
installed it is skipped, and the reason names the extra. In the gate's environment, which sets ``MICAH_ALL_EXTRAS``,
a missing extra is a failure, so that no test can stay skipped there unnoticed.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
# Extras that `make test` installs; every other one is a stage of its own in .ci/run.
IN_QUICK_SUITE = ("sim", "test")
ALL_EXTRAS_EXPECTED = "MICAH_ALL_EXTRAS" in os.environ


@cache
def distributions_of_extras() -> dict[str, frozenset[str]]:
    """Every extra and the distributions that it installs, those of the extras that it includes too."""
    listed = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]

    def expanded(lines: Iterable[str]) -> frozenset[str]:
        names: set[str] = set()
        for requirement in map(Requirement, lines):
            if requirement.name == "micah-plan":
                names.update(*(expanded(listed[extra]) for extra in requirement.extras))
            else:
                names.add(requirement.name)
        return frozenset(names)

    return {extra: expanded(lines) for extra, lines in listed.items()}


@cache
def is_installed(extra: str) -> bool:
    """Whether every distribution of an extra is installed."""
    try:
        return all(version(name) for name in distributions_of_extras()[extra])
    except PackageNotFoundError:
        return False


def reason(extra: str) -> str:
    """Why a test was skipped."""
    return f"needs the extra '{extra}'"


def skip_without(extra: str) -> None:
    """Skips the running test, or the tests of the running fixture, where an extra is missing."""
    if not is_installed(extra):
        (pytest.fail if ALL_EXTRAS_EXPECTED else pytest.skip)(reason(extra))


def requires(extra: str) -> pytest.MarkDecorator:
    """The mark of a test, or of all tests of a module, that need an extra."""
    assert extra in distributions_of_extras(), f"pyproject.toml has no extra {extra!r}"
    return pytest.mark.requires_extra(name=extra)


def module_requires(extra: str) -> pytest.MarkDecorator:
    """As `requires`, for a module that imports a library of the extra at its top: skips it before that import."""
    mark = requires(extra)
    if not is_installed(extra) and not ALL_EXTRAS_EXPECTED:
        pytest.skip(reason(extra), allow_module_level=True)
    return mark
