"""Predictions, their measures, baselines and pictures."""
