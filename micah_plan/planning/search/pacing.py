"""How many steps a path is given: what the search expects and what the transcription then plans with."""

# Share of the largest step that a path is divided by: what is left is for the feedback and the optimisation.
PACE = 0.6
# Steps added at the end for measurements only: at most so many, and only while each narrows the belief by at least 2 %.
MOST_LOCALISING_STEPS = 20
WORTH_A_STEP = 0.98
