"""Views with whole photographs and known backgrounds: colours tell where the object ends."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.fit import DetailFit, DetailWeights, MeshFit, Views
from neural_renderer.apps.fit.detail.pyramid import reduced
from neural_renderer.apps.fit.fit_pictures import comparison
from tests.apps.fit.test_detail import cameras

_RADIUS = 0.8


def ball() -> nr.Mesh:
    vertices, faces = nr.icosphere(4, radius=_RADIUS)
    return nr.Mesh(vertices, faces, vertex_colors=0.5 + 0.4 * torch.sin(6 * vertices))


def photographed(count: int = 10, size: int = 64, wrong: int = 3) -> Views:
    """Photograph a ball before patterns of squares; its masks are too large by some pixels."""
    views = Views.of(ball(), cameras(count), size)
    random = torch.Generator().manual_seed(0)
    squares = F.interpolate(torch.rand(count, 3, size // 8, size // 8, generator=random), (size, size))
    rest = 1 - views.masks[:, None]
    assert views.photos is not None
    scenes = views.photos + rest * squares
    masks = F.max_pool2d(views.masks[:, None], 2 * wrong + 1, 1, wrong)
    return replace(views, masks=masks[:, 0], photos=scenes * masks, scenes=scenes, backgrounds=squares)


@pytest.fixture(scope="module")
def views() -> Views:
    return photographed()


def test_views_keep_scenes_and_backgrounds(views: Views) -> None:
    some = views[[1, 3]].to("cpu").normalized(torch.zeros(3), 2.0)
    assert views.scenes is not None and views.backgrounds is not None
    torch.testing.assert_close(some.scenes, views.scenes[[1, 3]])
    torch.testing.assert_close(some.backgrounds, views.backgrounds[[1, 3]])
    plain = views.silhouettes()
    assert plain.photos is plain.scenes is plain.backgrounds is None
    with pytest.raises(ValueError, match="backgrounds: expected photos and scenes besides, got none"):
        replace(views, scenes=None)
    with pytest.raises(ValueError, match="scenes: expected"):
        replace(views, scenes=views.scenes[:, :, 1:])


def test_a_reduced_pixel_has_a_background_if_all_of_it_is_known(views: Views) -> None:
    assert views.backgrounds is not None
    holes = views.backgrounds.clone()
    holes[0, :, 5, 6] = torch.nan
    found = reduced(replace(views, backgrounds=holes), 4).backgrounds
    assert found is not None
    unknown = found.isnan()
    assert unknown[0, :, 1, 1].all() and int(unknown.sum()) == 3


def test_true_outlines_cut_out_the_object(views: Views) -> None:
    """The photograph without its background is the object on black, whatever the masks are."""
    exact = Views.of(ball(), views.camera, 64)
    assert exact.photos is not None and views.backgrounds is not None
    torch.testing.assert_close(views.cut_out(exact.masks), exact.photos, atol=1e-6, rtol=0)
    unknown = replace(views, backgrounds=torch.full_like(views.backgrounds, torch.nan))
    assert torch.equal(unknown.cut_out(exact.masks), views.photos)  # type: ignore[arg-type]
    assert torch.equal(exact.cut_out(exact.masks), exact.photos)


def radii(shape: tuple[Tensor, ...]) -> Tensor:
    return shape[0].norm(dim=1)


def test_colours_move_outlines_to_where_the_object_ends(views: Views) -> None:
    """From a ball as large as the masks, which is 3 of 24 pixels too large; without backgrounds it stays."""
    start = nr.icosphere(3, radius=_RADIUS * 27 / 24)
    found = []
    for each in (views, replace(views, backgrounds=None)):
        fit = DetailFit(each, *start, steps=60, light="none")
        while not fit.done:
            fit.advance()
        found.append(float(radii(fit.shape).mean()))
    assert found[0] < _RADIUS * 1.02 < _RADIUS * 1.08 < found[1]


def test_masks_count_where_the_background_is_unknown(views: Views) -> None:
    """The loss is that of views without backgrounds, if none is known."""
    assert views.backgrounds is not None
    unknown = replace(views, backgrounds=torch.full_like(views.backgrounds, torch.nan))
    start, weights = nr.icosphere(3, radius=_RADIUS), DetailWeights()
    numbers = [
        DetailFit(each, *start, steps=8, light="none", weights=weights).advance()
        for each in (unknown, replace(views, backgrounds=None))
    ]
    assert numbers[0] == numbers[1]


def test_a_fit_takes_the_texture_inside_its_outlines(views: Views) -> None:
    """No colour of the background gets into the texture, though masks show a rim of it."""
    fit = MeshFit(views, nr.Mesh(*nr.icosphere(3, radius=_RADIUS)), recover="texture", texture_steps=8)
    result = fit.run()
    assert result.fitted["psnr"].mean() > 25
    assert views.photos is not None
    plain = MeshFit(replace(views, backgrounds=None), fit.mesh(), recover="texture", texture_steps=8).run()
    assert plain.fitted["psnr"].mean() < 20  # the rim is missing
    picture = comparison(fit.views, fit.shape, columns=2)
    assert picture.shape == (3, 192, 128)
    assert views.scenes is not None
    assert torch.equal(picture[:, :64, :64], views.scenes[0])
    assert float(picture[:, 128:].mean()) > 0.95  # differences are small
