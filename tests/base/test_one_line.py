"""`repr` of what holds tensors: one line, whatever their sizes."""

from __future__ import annotations

import torch

import neural_renderer as nr


def test_results_are_one_line() -> None:
    mesh, camera = nr.Mesh.icosphere(1), nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
    images = nr.render(mesh, camera, 8, outputs=("alpha", "normal"))
    assert repr(images) == "Images(alpha=[1, 8, 8] float32, normal=[1, 3, 8, 8] float32)"
    points = nr.sample_points(mesh, 5)
    assert repr(points).startswith("SurfacePoints(points=[5, 3] float32, normals=[5, 3] float32, face_index=[5] int64")
    fragments, layers = nr.fragments(mesh, camera, 8), nr.fragments(mesh, camera, 8, layers=2)
    assert "face_index=[1, 16, 16] int32, settings=Settings(…)" in repr(fragments)
    assert repr(layers).startswith("Layers(layers=2 × Fragments(corners=[1, 80, 3, 3] float32")
    surface = nr.VisibleSurface.of(fragments, mesh, camera)
    assert repr(surface).startswith("VisibleSurface(points=[1, 16, 16, 3] float32, ")
    material = nr.Material("gold", metallic=1.0, normal_texture=nr.Texture(torch.rand(8, 8, 3)))
    assert "metallic=tensor(1.), " in repr(material) and "normal_texture=Texture(image=[8, 8, 3] float32" in repr(
        material
    )
    assert "opacity_texture" not in repr(material)
    assert repr(nr.EnvironmentLight(torch.rand(4, 8, 3))).startswith("EnvironmentLight(image=[4, 8, 3] float32")
    results = images, points, fragments, layers, surface, material, nr.remesh(mesh, 0.5)
    assert all("\n" not in repr(result) for result in results)
