"""Recordings: the value, and readers and writers for its file formats."""
