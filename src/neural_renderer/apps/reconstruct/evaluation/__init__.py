"""Predictions, measures, baselines and pictures."""
