"""Prediction and calibration: predicted against measured motion, and the effects that explain the residual."""
