"""Light from an environment image: directions, blurred reflections, the light itself."""
