"""The automaton as CasADi functions. The only package of the models that imports CasADi, with planning/transcription."""
