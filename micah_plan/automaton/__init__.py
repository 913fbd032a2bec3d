"""The object's model as values: joints, kinematic graph, regions, hybrid automaton and its transition logic."""
