"""Gradients by sampling and soft silhouettes, of other papers, to compare with."""
