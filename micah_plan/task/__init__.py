"""What is asked and what is answered: problems, starts, goals, settings and plans, as values, with their verbs."""
