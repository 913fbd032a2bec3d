"""Many cases at once: problems x values of their keys x seeds, on any executor, resumable, with one table."""
