"""POMDP-HD: search over mode sequences, belief-space transcription per sequence, feedback."""
