"""Effects: values, one formula per form, and their addition to an automaton."""
