"""Reading and writing of glTF 2.0 files, in JSON (.gltf) and binary (.glb)."""
