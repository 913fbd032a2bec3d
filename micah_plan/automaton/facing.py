"""Half-spaces that open in opposite directions: a boundary seen from its two sides."""

from __future__ import annotations

import numpy as np

from micah_plan.automaton.region import HalfSpace


def faces(h: HalfSpace, g: HalfSpace) -> bool:
    """Whether two half-spaces on x open in exactly opposite directions."""
    a, b = np.array(h.a), np.array(g.a)
    if h.on_input or g.on_input or not h.on_state or not g.on_state:
        return False
    return bool(np.allclose(a / np.linalg.norm(a), -b / np.linalg.norm(b), rtol=0.0, atol=1e-9))


def is_beyond(h: HalfSpace, g: HalfSpace) -> bool:
    """Whether g, which faces h, lies outside of h."""
    return -g.c / float(np.linalg.norm(g.a)) <= h.c / float(np.linalg.norm(h.a)) + 1e-9
