"""Estimators of the gradient through visibility: `nmr`, the paper's, and `edge`, the unbiased one."""
