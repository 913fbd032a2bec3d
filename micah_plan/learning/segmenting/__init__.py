"""Segmentation: noise, evidence, changepoints and their certainty."""
