"""Work on many models: lists of models, their views, shards of a data set, worker processes and engines.

`batch` runs the commands `fit`, `finish`, `style` and `dream`, which it imports by their names.
"""
