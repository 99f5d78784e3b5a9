"""The estimators of the gradient through visibility: `nmr`, the paper's, `edge`, the unbiased one, and comparators."""
