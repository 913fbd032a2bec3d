"""Several parts: their kinematic tree."""
