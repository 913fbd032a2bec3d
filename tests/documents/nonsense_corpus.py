"""Well-formed files that say nonsense: one edit of a shipped file each, (file, what is replaced, by what).

In what is replaced "*" stands for any number: models are learned anew now and then.
"""

from __future__ import annotations

import re

_M, _D, _C = "models/microwave.yaml", "models/drawer.yaml", "models/cabinet.yaml"
_P, _A, _S = "problems/drawer_open.yaml", "problems/microwave_close_by_arm.yaml", "problems/stapler_on_books.yaml"
_W, _X, _E = "problems/sweeps/drawer.yaml", "problems/explore_handle.yaml", "problems/experiments/drawer.yaml"
_B = "models/parts/drawer.yaml"

CORPUS = {
    # Expressions.
    "weight of rounding": (_M, "guard: [door >= 1.2", "guard: [1.0e-300*door >= 1.2"),
    "giant weight": (_M, "guard: [door < 0.0]", "guard: [1.0e300*door < 0.0]"),
    "guard beyond the world": (_M, "guard: [door >= 1.20609]", "guard: [door >= 1.0e12]"),
    "far half-space of two": (_M, "guard: [input door < 0.0]", "guard: [door - 2*input door > 1.0e12]"),
    "far input": (_M, "guard: [input door < 0.0]", "guard: [input door < -1.0e12]"),
    "giant gain": (_M, "door: input door", "door: 1.0e12*input door"),
    "gain of rounding": (_M, "door: input door", "door: 1.0e-300*input door"),
    "reset out of this world": (_M, "      door: 0.0\n", "      door: 1.0e12\n"),
    "giant reset": (_M, "      door: 0.0\n", "      door: 1.0e12*door\n"),
    "invariant out of this world": (_M, "invariant: [door >= 0.0, door", "invariant: [door >= -1.0e300, door"),
    "drift of a whole turn": (_M, "door: input door", "door: input door + 6.3"),
    "step that is all noise": (_M, "process_std:\n    door: *", "process_std:\n    door: 30.0"),
    "measurement that is all noise": (_M, "observation_std:\n    door: *", "observation_std:\n    door: 100.0"),
    "threshold anywhere": (_M, "threshold_std: *", "threshold_std: 3.005"),
    "step of the state": (_M, "door: input door", "door: door + input door"),
    "nothing compared": (_M, "guard: [door >= 1.20609]", "guard: [0*door >= 1.2]"),
    "a number compared": (_M, "guard: [door >= 1.20609]", "guard: [2 >= 1.2]"),
    # Models.
    "empty range": (_M, "invariant: [door >= 0.0, door <= 1.2", "invariant: [door >= 2.0, door <= 1.2"),
    "guard out of its mode": (_M, "guard: [door >= 1.20609]", "guard: [door >= 9.5]"),
    "unknown mode": (_M, "target: rigid", "target: frozen"),
    "no axis": (_M, "axis: [0.0014141338, 0.0010742745, -0.9999984231]", "axis: [0, 0, 0]"),
    "no rotation": (_M, "quaternion: [*, *, *, *]", "quaternion: [0, 0, 0, 0.001]"),
    "radius of a town": (_M, "center: [-0.239504, 0.0", "center: [-23950.0, 0.0"),
    "kind unlike its numbers": (_M, "kind: revolute\n        position", "kind: prismatic\n        position"),
    "rest elsewhere": (_M, "held: 1.20609", "held: 0.3"),
    "pin elsewhere": (_M, "value: 1.20609", "value: 0.4"),
    "negative noise": (_M, "    door: 0.00044", "    door: -0.00044"),
    "no noise of sensors": (_M, "observation_std:\n    door: *", "observation_std:\n    door: 0.0"),
    "negative threshold": (_M, "threshold_std: *", "threshold_std: -0.005"),
    "two coordinates of a name": (_M, "coordinates:\n  door: rad", "coordinates:\n  door: rad\n  door: rad"),
    "unit of nobody": (_M, "coordinates:\n  door: rad", "coordinates:\n  door: deg"),
    "part of itself": (_M, "parent: base\n    child: door\n    c", "parent: door\n    child: door\n    c"),
    "base that moves": (_M, "child: door\n    coordinate", "child: base\n    coordinate"),
    "flat solid": (_M, "size: [0.36, 0.02, 0.28]", "size: [0.36, 0.0, 0.28]"),
    "negative solid": (_M, "size: [0.36, 0.02, 0.28]", "size: [0.36, -0.02, 0.28]"),
    "sphere of three sizes": (_M, "kind: cylinder\n", "kind: sphere\n"),
    "colour of nobody": (_M, "color: '#e6b450'", "color: '#zzzzzz'"),
    "part 50 m apart": (_M, "position: [0.0697588, 0.01", "position: [50.0697, 0.01"),
    "part 2 m apart": (_M, "position: [0.0697588, 0.01", "position: [2.0697, 0.01"),
    "rows from the end": (_M, "rows: [0, 82]", "rows: [82, 0]"),
    "shares beyond one": (_M, "revolute: *", "revolute: 9.5"),
    "shares that do not add up": (_M, "- [*, *, *, *, *]", "- [0.0, 0.9, 0.9, 0.9, 0.0]"),
    "another format": (_M, "micah-plan/model/1", "micah-plan/model/9"),
    "effect of nobody": (_M, "learned:\n", "effects:\n  - {name: magic, coordinate: door, parameters: {}}\nlearned:\n"),
    "negative gain": (_M, "learned:\n",
                      "effects:\n  - {name: gain, coordinate: door, parameters: {gain: -400}}\nlearned:\n"),
    "delay of an hour": (_M, "learned:\n",
                         "effects:\n  - {name: delay, coordinate: door, parameters: {steps: 72000}}\nlearned:\n"),
    "infinite pitch": (_D, "kind: prismatic\n", "kind: screw\n        pitch: .inf\n"),
    "drawer in rad": (_D, "coordinates:\n  drawer: m", "coordinates:\n  drawer: rad"),
    "drawer of a kilometre": (_D, "[drawer >= 0.0, drawer <= 0.279", "[drawer >= 0.0, drawer <= 1.0e7 + 0.2"),
    "handle a kilometre away": (_D, "handle: [0.0, 0.03, 0.0]", "handle: [0.0, 1000.0, 0.0]"),
    # Parts.
    "parts of nothing": (_B, "size: [0.44, 0.02, 0.18]", "size: [0.44, .nan, 0.18]"),
    "part twice": (_B, "  drawer:\n", "  base: {}\n  drawer:\n"),
    "giant part": (_B, "size: [0.44, 0.02, 0.18]", "size: [440, 1.0e9, 180]"),
    "drawer in mm": (_B, "handle: [0.0, 0.03, 0.0]", "handle: [0.0, 30000.0, 0.0]"),
    # Problems.
    "start elsewhere": (_P, "mean: {drawer: 0.03}", "mean: {drawer: 7}"),
    "start of text": (_P, "mean: {drawer: 0.03}", "mean: {drawer: shut}"),
    "start of another": (_P, "mean: {drawer: 0.03}", "mean: {door: 0.03}"),
    "start without spread": (_P, "std: {drawer: 0.01}", "std: {drawer: 0.0}"),
    "negative spread": (_P, "std: {drawer: 0.01}", "std: {drawer: -0.01}"),
    "goal out of range": (_P, "value: 0.25", "value: 0.9"),
    "goal of nothing": (_P, "tolerance: 0.01", "tolerance: 0.0"),
    "goal of less than rounding": (_P, "tolerance: 0.01", "tolerance: 1.0e-300"),
    "goal as wide as a house": (_P, "tolerance: 0.01", "tolerance: 50.0"),
    "goal in no mode": (_P, "tolerance: 0.01}", "tolerance: 0.01}\n  modes: [frozen]"),
    "sure beyond one": (_P, "planner:", "confidence: 95\nplanner:"),
    "surely not": (_P, "planner:", "confidence: 0.0\nplanner:"),
    "no noise of the tracker": (_P, "observation_std: {drawer: 0.003}", "observation_std: {drawer: 0.0}"),
    "tracker of a kilometre": (_P, "observation_std: {drawer: 0.003}", "observation_std: {drawer: 900.0}"),
    "wind of a kilometre": (_P, "process_std: {drawer: 0.002}", "process_std: {drawer: 900.0}"),
    "step backwards": (_P, "max_step: {drawer: 0.03}", "max_step: {drawer: -0.03}"),
    "step over all": (_P, "max_step: {drawer: 0.03}", "max_step: {drawer: 300.0}"),
    "no knots": (_P, "planner:\n", "planner:\n  max_knots: 0\n"),
    "half a knot": (_P, "planner:\n", "planner:\n  max_knots: 2.5\n"),
    "no time": (_P, "planner:\n", "planner:\n  solve_time_limit_s: 0\n"),
    "planner of nobody": (_P, "planner:\n", "planner:\n  method: wish\n"),
    "noise of a plant in mm": (_P, "position_noise: 0.003", "position_noise: 3000.0"),
    "negative noise of a plant": (_P, "position_noise: 0.003", "position_noise: -0.003"),
    "body in a body of rounding": (_P, "goal:", "scene: {b: {shapes: [{kind: sphere, size: [1.0e-300]}]}}\ngoal:"),
    "body of nothing": (_P, "goal:", "scene: {b: {shapes: []}}\ngoal:"),
    "weight of a body": (_S, "mass: 3.0", "mass: -3.0"),
    "weight of a moon": (_S, "mass: 3.0", "mass: 7.0e22"),
    "stapler as wide as a town": (_S, "point: [0.1, 0.0, 0.04]", "point: [1.0e9, 0.0, 0.04]"),
    "travel backwards": (_S, "travel: 0.57", "travel: -0.57"),
    "travel of rounds": (_S, "travel: 0.57", "travel: 57000.0"),
    "reach inside out": (_S, "lower: [-0.3, -0.2, 0.0]", "lower: [3.0, -0.2, 0.0]"),
    "face of nobody": (_S, "face: +z", "face: up"),
    "contact with nobody": (_S, "body: table", "body: moon"),
    "support of nobody": (_S, "support: book_4", "support: book_9"),
    "fingers of another": (_S, "left_finger_mount: 0.015", "left_thumb: 0.015"),
    "fingers through each other": (_S, "left_finger_mount: 0.015", "left_finger_mount: 15.0"),
    "hand far away": (_A, "position: [0.03, 0.045, 0.0]", "position: [300.0, 0.045, 0.0]"),
    "arm far away": (_A, "position: [0.15, 0.8, -0.15]", "position: [15000.0, 0.8, -0.15]"),
    "tool of nobody": (_A, "tool: tool", "tool: spoon"),
    "quaternion of another norm": (_A, "quaternion: [0.5, 0.5, -0.5, 0.5]", "quaternion: [5, 5, -5, 5]"),
    # Scenes, sweeps, experiments.
    "no force": (_X, "largest_force: 45.0", "largest_force: 0"),
    "force of a rocket": (_X, "largest_force: 45.0", "largest_force: 4.5e7"),
    "step of a town": (_X, "largest_step: 0.05", "largest_step: 5000.0"),
    "opening of a town": (_X, "opening: 0.2", "opening: 2000.0"),
    "no opening": (_X, "opening: 0.2", "opening: 0.0"),
    "no steps": (_X, "steps: 300", "steps: 0"),
    "spread in a sweep": (_W, "[0.005, 0.02]", "[0.005, -0.02]"),
    "confidence in a sweep": (_W, "confidence: [0.9, 0.99]", "confidence: [0.9, 99]"),
    "key in a sweep": (_W, "start.std.drawer", "start.std.door"),
    "no seeds": (_W, "seeds: 2", "seeds: 0"),
    "the same value twice": (_W, "confidence: [0.9, 0.99]", "confidence: [0.9, 0.9]"),
    "step in an experiment": (_E, "drawer: [0.03, 0.0", "drawer: [3.0e10, 0.0"),
    "start of an experiment": (_E, "mean: {drawer: 0.1}", "mean: {drawer: 10.0}"),
    "no repetition": (_E, "repetitions: 3", "repetitions: -3"),
}  # fmt: skip


def replaced(text: str, before: str, after: str) -> str:
    """A text with the first place of another one replaced, which must be there."""
    pattern = re.escape(before).replace(r"\*", r"-?[\d.]+(?:e[-+]?\d+)?")
    changed, count = re.subn(pattern, lambda _: after, text, count=1)
    assert count == 1, before
    return changed
