"""Records: the steps of a run in one HTML file."""
