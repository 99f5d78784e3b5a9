"""Details of a shape: normals and depth move its vertices, and it is remeshed on the way."""
