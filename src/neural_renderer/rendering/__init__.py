"""Rendering: `forward` renders a scene to images, `deferred` returns the visible face of each pixel for a shader."""
