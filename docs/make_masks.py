"""Make docs/masks_right.jpg and docs/masks_wrong.jpg, sheets as `fit` writes them: `python docs/make_masks.py`.

A cow on a chequered table is drawn from four sides. The wrong masks lack its feet and have a piece of the table: both
are usual if a foot has the colours of the table.
"""

import tempfile
from pathlib import Path

import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.fit.photos.masks.mask_sheet import mask_sheet

HERE = Path(__file__).parent
SIZE, VIEWS = (240, 320), 4


def scene() -> tuple[nr.Mesh, nr.Mesh]:
    """The cow, and the table that it stands on."""
    cow = nr.Mesh.load(HERE.parent / "examples" / "data" / "spot.obj").normalize()
    place = torch.linspace(-1.8, 1.8, 19)
    x, z = torch.meshgrid(place, place, indexing="ij")
    vertices = torch.stack((x, torch.full_like(x, float(cow.vertices[:, 1].min())), z), -1).reshape(-1, 3)
    row, column = torch.meshgrid(torch.arange(18), torch.arange(18), indexing="ij")
    corner = (19 * row + column).reshape(-1, 1)
    faces = torch.cat((corner + torch.tensor([0, 1, 20]), corner + torch.tensor([0, 20, 19])))
    shade = torch.where((row + column) % 2 == 0, 0.85, 0.35).reshape(-1, 1) * torch.tensor([0.95, 0.85, 0.7])
    return cow, nr.Mesh(vertices, faces, face_colors=shade.repeat(2, 1))


def main() -> None:
    """Draw photographs, right and wrong masks, and both sheets."""
    cow, table = scene()
    eyes = nr.get_points_from_angles(4.2, 24.0, torch.arange(VIEWS) * 45.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=17)
    options = {"far": 100.0, "background": (0.75, 0.78, 0.8)}
    photos = nr.render(nr.join([cow, table]), camera, SIZE, **options).rgb
    fragments = nr.fragments(cow, camera, SIZE)
    height = fragments.composite(fragments.interpolate(cow.vertices)[..., 1:2], background=-9.0)[:, 0]
    right = (height > -2.0).float()
    floor = float(cow.vertices[:, 1].min())
    ground = nr.fragments(table, camera, SIZE)
    corner = ground.composite(ground.interpolate(table.vertices)[..., [0, 2]], background=9.0)
    wedge = ((corner - torch.tensor([0.45, 0.1])[:, None, None]).abs().amax(1) < 0.3).float()
    wrong = torch.maximum(right * (height > floor + 0.34), wedge)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{number}.png" for number in range(VIEWS)]
        for file, photo in zip(files, photos, strict=True):
            nr.save_image(file, photo)
        for name, masks in (("right", right), ("wrong", wrong)):
            inner = Path(folder) / name
            inner.mkdir()
            for file, mask in zip(files, masks, strict=True):
                nr.save_image(inner / file.name, mask[None].expand(3, -1, -1))
            picture = Image.fromarray(mask_sheet(files, inner, {}).numpy())
            picture.save(HERE / f"masks_{name}.jpg", quality=80)


if __name__ == "__main__":
    main()
