"""Modules of the first packages by their old names, and functions that only those modules had."""

from __future__ import annotations

import importlib
import importlib.util
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr

MODULES = {
    "cross": "cross",
    "get_points_from_angles": "get_points_from_angles",
    "lighting": "lighting",
    "load_obj": "load_obj load_mtl load_textures",
    "look": "look",
    "look_at": "look_at",
    "mesh": "Mesh",
    "optimizers": "Adam",
    "perspective": "perspective",
    "projection": "projection",
    "rasterize": "rasterize rasterize_rgbad rasterize_silhouettes rasterize_depth Rasterize RasterizeFunction "
    "DEFAULT_IMAGE_SIZE DEFAULT_ANTI_ALIASING DEFAULT_NEAR DEFAULT_FAR DEFAULT_EPS DEFAULT_BACKGROUND_COLOR",
    "renderer": "Renderer",
    "save_obj": "save_obj create_texture_image",
    "vertices_to_faces": "vertices_to_faces",
}


@pytest.mark.parametrize("name", MODULES)
def test_modules_hold_the_names_and_leave_the_functions(name):
    module = importlib.import_module(f"neural_renderer.{name}")
    assert set(module.__all__) == set(MODULES[name].split()) <= set(dir(module))
    assert all(hasattr(module, key) for key in module.__all__) and not hasattr(module, "nothing")
    for key in set(MODULES[name].split()) & set(nr.__all__):
        assert getattr(module, key) is getattr(nr, key)
    assert callable(getattr(nr, name)) if name in nr.__all__ else getattr(nr, name) is module
    assert importlib.util.find_spec(f"neural_renderer.{name}") is module.__spec__


def test_as_the_first_import_of_a_program():
    code = (
        "import neural_renderer.projection, neural_renderer.load_obj as load_obj\n"
        "from neural_renderer.renderer import Renderer\n"
        "import neural_renderer as nr\n"
        "assert callable(nr.projection) and callable(load_obj) and nr.renderer.Renderer is Renderer is nr.Renderer\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_pickles_name_the_old_modules():
    """A protocol 0 pickle of a class is its module's and its own name."""
    assert pickle.loads(b"cneural_renderer.renderer\nRenderer\n.") is nr.Renderer
    assert pickle.loads(b"cneural_renderer.mesh\nMesh\n.") is nr.Mesh


@pytest.mark.parametrize(
    "statement",
    [
        "import neural_renderer.cuda",
        "import neural_renderer.cuda.rasterize as rasterize_cuda",
        "from neural_renderer import cuda",
        "from neural_renderer.cuda import create_texture_image",
    ],
)
def test_extensions_are_told_apart_from_what_is_missing(statement):
    with pytest.raises(ImportError, match=r"no compiled extensions; .*neural_renderer\.rasterize_rgbad"):
        exec(statement)
    with pytest.raises(ModuleNotFoundError, match=r"No module named .neural_renderer\.cudas"):
        importlib.import_module("neural_renderer.cudas")


def test_materials_of_a_file(tmp_path):
    Image.fromarray(np.full((2, 2, 3), 51, np.uint8)).save(tmp_path / "dark.png")
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl dark\nKd 0 1 0\nmap_Kd -clamp on dark.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"
    triangles = "usemtl red\nf 1/1 2/1 3/1\nusemtl dark\nf 3/1 2/1 1/1\n"
    (tmp_path / "plain.obj").write_text(corners + triangles)
    (tmp_path / "named.obj").write_text("mtllib m.mtl\n" + corners + triangles)
    module = importlib.import_module("neural_renderer.load_obj")
    colors, images = module.load_mtl(tmp_path / "m.mtl")
    assert {name: color.tolist() for name, color in colors.items()} == {"red": [1, 0, 0], "dark": [0, 1, 0]}
    assert images == {"dark": "dark.png"}
    textures = module.load_textures(tmp_path / "plain.obj", tmp_path / "m.mtl", 2)
    assert torch.equal(textures, nr.load_obj(tmp_path / "named.obj", texture_size=2, load_texture=True)[2])
    assert textures[0, 0, 0, 0].tolist() == [1, 0, 0] and torch.allclose(textures[1], torch.tensor(0.2))


@pytest.mark.parametrize("side", [16, 24])
def test_create_texture_image(device, side):
    textures = torch.rand(5, 3, 3, 3, 3, generator=torch.Generator().manual_seed(0))
    create = importlib.import_module("neural_renderer.save_obj").create_texture_image
    picture, uv = create(textures.to(device), side)
    assert (
        picture.shape == (2 * side, 3 * side, 3) and picture.dtype == uv.dtype == np.float32 and uv.shape == (5, 3, 2)
    )
    column, row = (
        np.rint(uv[..., 0] * (3 * side - 1)).astype(int),
        np.rint((1 - uv[..., 1]) * (2 * side - 1)).astype(int),
    )
    corners = torch.stack([textures[:, 2, 0, 0], textures[:, 0, 2, 0], textures[:, 0, 0, 2]], 1)
    assert np.abs(picture[row, column] - corners.numpy()).max() <= 0.5 / 255 + 1e-6  # rounded to 255 levels


def test_rasterize_function_and_cross(device):
    random = torch.Generator().manual_seed(0)
    faces = (torch.rand(1, 9, 3, 3, generator=random) * 2 - 1 + torch.tensor([0, 0, 2.0])).to(device)
    textures = torch.rand(1, 9, 2, 2, 2, 3, generator=random).to(device)
    settings = (20, 0.1, 100, 1e-4, (1, 0, 0))
    function = importlib.import_module("neural_renderer.rasterize").RasterizeFunction
    found = function.apply(faces, textures, *settings, True, True, True)
    assert all(map(torch.equal, found, nr.Rasterize(*settings, True, True, True)(faces, textures)))
    a, b = torch.rand(2, 4, 3, generator=random).to(device)
    assert torch.equal(nr.cross(a, b), torch.linalg.cross(a, b))
    with pytest.raises(ValueError, match=r"b: expected shape \[4, 3\]"):
        nr.cross(a, b[:2])
