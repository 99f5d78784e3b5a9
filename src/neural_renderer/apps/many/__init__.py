"""Work on many models: lists of models, their views, shards of a data set, worker processes and engines."""
