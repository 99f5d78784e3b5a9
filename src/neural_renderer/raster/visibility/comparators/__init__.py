"""Gradients of other papers, to compare with: OpenDR, and the score function (REINFORCE)."""
