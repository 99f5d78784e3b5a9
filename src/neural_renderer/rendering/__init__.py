"""Drawing: `forward` draws a scene to images, `deferred` gives the visible faces of each pixel to a shader."""
