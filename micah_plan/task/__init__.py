"""Problems and their solutions: problems, starts, goals, settings and plans as values, with their functions."""
