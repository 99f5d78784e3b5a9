"""Generated training shapes: parts, grammars of categories, and pictures of them."""
