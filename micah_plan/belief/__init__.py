"""Hybrid Gaussian beliefs: the value, and the filter that moves it with inputs and measurements."""
