"""A robot's file after the checks, as Pinocchio gets it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

# Limits of joints without limits, in files whose parsers know no infinity.
NO_LIMIT = 1e9


@dataclass(frozen=True)
class CheckedRobot:
    """What was found in a file.

    Attributes:
        kind: format of the text.
        text: clean, with absolute mesh paths.
        colors: of the shapes of each link, as ``"#rrggbb"``; the last serves further shapes.
        mimics: joints that follow another one.
    """

    kind: Literal["urdf", "mjcf"]
    text: str
    colors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mimics: frozenset[str] = frozenset()
