"""The automaton as CasADi functions. Only this package and planning/transcription import CasADi."""
