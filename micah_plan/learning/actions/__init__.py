"""How recorded actions move a part: frame, gain and delay."""
