"""YAML model and problem files: typed, checked with line numbers, and converted to and from the values."""
