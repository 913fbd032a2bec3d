"""The four answers of a calibration."""

from __future__ import annotations

from typing import Literal

Verdict = Literal["none", "explained", "partly", "unexplained"]
SENTENCES: dict[Verdict, str] = {
    "none": "The model lacks nothing that this recording can show.",
    "explained": "The effects below explain what the model lacked.",
    "partly": "The effects below explain a part of what the model lacks.",
    "unexplained": "The model lacks something that no effect of the library explains.",
}

# Shares of the explainable residual that effects leave: up to here it is explained, from there on it is not.
_EXPLAINED = 0.03
_UNEXPLAINED = 0.5


def verdict(effects: int, is_left: bool, is_suspect: bool, fraction_left: float) -> Verdict:
    """What to say.

    Args:
        effects: how many named effects were found.
        is_left: whether a smooth correction still predicts better, by `fraction_left` of the explainable error.
        is_suspect: whether what remains is correlated in time, or the correction alone predicts better.
    """
    if not effects:
        return "unexplained" if is_left or is_suspect else "none"
    if is_left and fraction_left > _UNEXPLAINED:
        return "unexplained"
    if is_suspect or (is_left and fraction_left > _EXPLAINED):
        return "partly"
    return "explained"


def overall(verdicts: list[Verdict]) -> Verdict:
    """One answer for several coordinates: `none` says nothing, and differing answers make `partly`."""
    said = {one for one in verdicts if one != "none"}
    if not said:
        return "none"
    return said.pop() if len(said) == 1 else "partly"
