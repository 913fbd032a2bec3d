"""From a recording to a kinematic graph and a hybrid automaton: CHAMP and Act-CHAMP."""
