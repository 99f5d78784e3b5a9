"""Applications of the renderer: fitting, editing and single-image reconstruction."""
