"""Several parts: which one hangs on which."""
