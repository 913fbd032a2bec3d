"""Several parts: which one is attached to which."""
