"""The high level of POMDP-HD: roadmaps per mode, joined by guards, and the cheapest mode sequences."""
