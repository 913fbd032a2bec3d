"""Files to start from: they work as they are and say in comments what to change."""
