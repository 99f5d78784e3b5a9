"""The viewer: meshes in the browser while work goes on, and records of them. `viewer.Viewer` is its centre."""
