"""The parts of the panel on the page."""
