"""Masks of objects in pictures: from files, transparency, backgrounds, thresholds and boxes."""
