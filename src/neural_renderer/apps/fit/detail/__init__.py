"""Details of a shape: normals and depth move its vertices, with continuous remeshing."""
