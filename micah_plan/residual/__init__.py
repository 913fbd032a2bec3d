"""What the model says against what was measured: tracks in configuration space and prediction errors."""
