"""A differentiable mesh renderer."""
