"""Registry of forms. `register` adds your own, a class with one formula: see `form.EffectForm`."""

from __future__ import annotations

from micah_plan.automaton.effects import commands, drives, ends, forces, geometry, memories, sensors
from micah_plan.automaton.effects.form import EffectForm
from micah_plan.errors import OF_YOUR_OWN, InputError, shown

# In the order of lists and reports: of the command, the joint, ends and guards, geometry, the sensor.
_LIBRARY: tuple[EffectForm, ...] = (
    *(commands.Gain(), commands.Bias(), memories.Follow(), geometry.FrameRotation(), memories.Delay(), memories.Lag()),
    *(memories.Ramp(), commands.DirectionGain(), commands.Saturation(), commands.DeadZone()),
    *(memories.Backlash(), memories.StickSlip(), drives.Drive()),
    *(forces.Spring(), forces.Gravity(), forces.Latch(), ends.Limit()),
    *(geometry.ScrewPitch(), geometry.AxisOffset(), ends.GuardShift(), ends.GuardHysteresis()),
    *(sensors.SensorScale(), sensors.SensorOffset(), sensors.Drift(), forces.Unexplained()),
)
_FORMS: dict[str, EffectForm] = {form.name: form for form in _LIBRARY}


def form(name: str) -> EffectForm:
    """The form of that name.

    Raises:
        InputError: if there is none; the message lists the names.
    """
    if name not in _FORMS:
        remedy = f"choose one of {', '.join(_FORMS)}; {OF_YOUR_OWN}"
        raise InputError(f"unknown effect {shown(name)}", remedy=remedy)
    return _FORMS[name]


def forms() -> tuple[EffectForm, ...]:
    """All forms, the library's first."""
    return tuple(_FORMS.values())


def register(new: EffectForm) -> EffectForm:
    """Add a form for automata, files, prediction and calibration.

    Raises:
        InputError: if its name is taken or its description is incomplete.
    """
    if new.name in _FORMS:
        raise InputError(f"an effect {shown(new.name)} exists already", remedy="choose another name")
    if len(new.layers) != 1 or not new.parameters or not new.sentence or not new.source:
        raise InputError(f"effect {shown(new.name)} must have hooks of one layer, parameters, a sentence and a source")
    _FORMS[new.name] = new
    return new


def unregister(name: str) -> None:
    """Remove a form that `register` added."""
    if name not in {form_class.name for form_class in _LIBRARY}:
        _FORMS.pop(name, None)
