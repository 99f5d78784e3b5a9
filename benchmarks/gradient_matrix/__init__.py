"""The gradient of every output in every case, against central differences of the mean over sub-pixel shifts.

`cases` has the scenes and the directions in which their vertices move, `measure` the differences and the estimates,
`limits` the cells that are known to be off with their causes, `report` the table and the figure.
``python -m benchmarks.gradient_matrix --json FILE --plot FILE`` measures all; see ``--help``.
"""
