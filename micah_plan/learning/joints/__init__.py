"""Joints fitted to rows: closed forms, batches, and the last robust fit with its covariance."""
