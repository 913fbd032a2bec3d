"""What the model says against what was measured."""
