"""The viewer: meshes in the browser during a computation, and recordings. The main class is `viewer.Viewer`."""
