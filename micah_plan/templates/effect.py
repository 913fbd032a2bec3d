"""An effect of your own: a bearing that drags the more, the faster the part is moved.

Run it as it is: `python effect.py` checks the form, and shows a drawer with and without it. To have it in
calibration, predictions and plans, give commands this file (`micah-plan calibrate ... --code effect.py`), or import it
before you call any of `micah_plan`: `register` does the rest.
"""

from __future__ import annotations

from typing import final

import numpy as np

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.registry import register
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.transition import simulate
from micah_plan.documents.model import load_model
from micah_plan.symbolic.form_check import check_form


@final
class SpeedDrag(EffectForm):
    """v -> v / (1 + drag |v|)."""

    name = "speed_drag"
    sentence = "Large commands fall short by a share that grows with their size."
    source = "a guess of mine"
    # Name, unit ("coordinate": rad or m), neutral value, smallest and largest value.
    parameters = (Parameter("drag", "1/coordinate", 0.0, 0.0, 50.0),)

    # One formula for NumPy and for CasADi: use the functions of `ops` instead of numpy's, and no `if` on values.
    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        """The part of a command v that reaches the joint."""
        return v / (1.0 + p[0] * ops.abs(v))


FORM = register(SpeedDrag())


def main() -> None:
    """Check the form and print its effect on the drawer in model.yaml."""
    check_form(FORM)
    print(f"{FORM.name} conforms")
    plain = load_model("model.yaml")
    dragged = with_effect(plain, Effect(FORM.name, "drawer", (("drag", 10.0),)))
    commands = np.full((5, 1), 0.04)
    for name, automaton in (("without", plain), ("with", dragged)):
        path = simulate(automaton, "slides", np.array([0.05]), commands)
        print(f"{name:8}", np.round(path.states[:, 0], 4))


if __name__ == "__main__":
    main()
