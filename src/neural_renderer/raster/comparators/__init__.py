"""Gradients and silhouettes of other papers, to compare with."""
