"""Style transfer and DeepDream: losses against their formulas, and optimisation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.adjustable import generator
from neural_renderer.apps.common.features import FeatureNetwork, load_features
from neural_renderer.apps.common.features.vgg import vgg
from neural_renderer.apps.edit import Dream, DreamWeights, MeshEdit, RandomViews, Style, StyleWeights
from neural_renderer.apps.edit.edit_pictures import preview
from neural_renderer.apps.edit.objective import Deformation
from neural_renderer.apps.edit.style import gram
from neural_renderer.meshes.topology import Topology
from tests.apps.edit.networks import vgg_weights
from tests.rounding import EPS, relative, rounding

LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3")


@pytest.fixture(scope="module")
def network() -> FeatureNetwork:
    return vgg(vgg_weights())


def painting() -> Tensor:
    """Make an orange painting with soft stripes, [3, 40, 56]."""
    stripes = 0.1 * torch.sin(torch.arange(56) * 0.9)
    return (torch.tensor([0.55, 0.35, 0.15])[:, None, None] + stripes).expand(3, 40, 56)


def ball(*colour: float) -> nr.Mesh:
    mesh = nr.Mesh.icosphere(2)
    if colour:
        mesh.textures.data[:] = torch.tensor(colour)
    return mesh


def unmoved(mesh: nr.Mesh) -> Deformation:
    return Deformation(mesh.vertices.detach(), mesh.vertices.detach(), Topology.of(mesh.faces))


def test_gram_matrices_are_those_of_the_published_code() -> None:
    features, masks = torch.randn(2, 5, 4, 6), torch.rand(2, 16, 24)
    expected = torch.zeros(2, 5, 5)
    for image in range(2):
        mask = F.avg_pool2d(masks[image][None], 4)[0]
        for y in range(4):
            for x in range(6):
                pixel = features[image, :, y, x]
                expected[image] += mask[y, x] * torch.outer(pixel, pixel)
        expected[image] /= 5 * mask.sum()
    torch.testing.assert_close(gram(features, masks), expected)  # 24 terms


def test_sums_are_those_of_the_published_code(network: FeatureNetwork) -> None:
    style = Style(network, painting(), 48, weights=StyleWeights(2.0, 0.0, 3.0), relative=False)
    images, masks = torch.rand(2, 3, 48, 48), torch.ones(2, 48, 48)
    masks[:, :5] = 0.5
    mesh = ball()
    vertices = mesh.vertices.detach() + 0.1
    shape = Deformation(vertices, mesh.vertices.detach(), Topology.of(mesh.faces))
    found = style.losses(images, masks, shape)
    total = torch.zeros(())
    resized = F.interpolate(painting()[None], (41, 57), mode="bilinear", antialias=True)
    target = network(resized, LAYERS)
    for name, features in network(images, LAYERS).items():
        flat = target[name].flatten(2)
        reference = flat @ flat.transpose(1, 2) / (flat.shape[1] * flat.shape[2])
        total = total + (gram(features, masks) - reference).square().sum() / 2  # a mean over the batch
    # Sums over the painting's pixels, 162 vertices, 48 x 48 pixels; a vertex has moved by 0.1 that were added to 1.
    torch.testing.assert_close(found["style"], total, **relative(2 * 41 * 57))
    torch.testing.assert_close(found["content"], torch.tensor(2.0 * 162 * 3 * 0.01), **relative(162 * 3 + 20))
    inside = masks == 1
    torch.testing.assert_close(
        found["variation"], 3 * nr.losses.total_variation(images, inside), **relative(2 * 3 * 2 * 48**2)
    )


def test_relative_losses_do_not_depend_on_the_networks_scale() -> None:
    images, masks = torch.rand(2, 3, 48, 48), torch.ones(2, 48, 48)
    found = []
    for scale in (1.0, 10.0):
        weights = vgg_weights()
        weights["conv1_1.weight"] *= scale
        style = Style(vgg(weights), painting(), 48)
        found.append(style.losses(images, masks, unmoved(ball()))["style"])
    torch.testing.assert_close(found[0], found[1], **relative(2 * 48**2))
    itself = F.interpolate(painting()[None], (41, 57), mode="bilinear", antialias=True)
    assert style.measure(itself, torch.ones(1, 41, 57)) <= (41 * 57 * EPS) ** 2


def test_the_background_does_not_leak_into_the_style(network: FeatureNetwork) -> None:
    style = Style(network, painting(), 64, layers=("conv1_2", "conv2_2"))
    masks = torch.zeros(1, 64, 64)
    masks[:, 20:40, 10:50] = 1
    inside = torch.rand(1, 3, 64, 64)
    far = torch.ones(64, 64, dtype=torch.bool)
    far[20 - 6 : 40 + 6, 10 - 6 : 50 + 6] = False  # the receptive field of the layers around the object
    for grey in (0.0, 1.0):
        images = (inside * masks + grey * (1 - masks)).requires_grad_()
        loss = style.losses(images, masks, unmoved(ball()))["style"]
        (gradient,) = torch.autograd.grad(loss, images)
        assert (gradient[..., far] == 0).all() and (gradient[..., 20:40, 10:50] != 0).all()


def test_transparent_pixels_of_a_painting_do_not_count(network: FeatureNetwork) -> None:
    stripes = painting()
    half_clear = torch.zeros(4, 40, 112)
    half_clear[:3, :, :56], half_clear[3, :, :56] = stripes, 1
    half_clear[0, :, 56:] = 1  # invisible red
    bare = Style(network, stripes, 48)
    covered = Style(network, half_clear, 48 * 2**0.5)
    images, masks = F.interpolate(stripes[None], (48, 48)), torch.ones(1, 48, 48)
    assert covered.measure(images, masks) < bare.measure(images, masks) + 0.03
    torch.testing.assert_close(
        covered.background(1, generator(0, 0)), bare.background(1, generator(0, 0)), atol=0.02, rtol=0
    )


def test_paintings_that_are_refused(network: FeatureNetwork) -> None:
    for wrong, sentence in (
        (torch.rand(3, 8, 40), "at least 16 pixels"),
        (torch.rand(3, 16, 400), "an aspect ratio of at most 16, got 400 x 16"),
        (torch.zeros(4, 40, 40), "fully transparent"),
        (torch.rand(2, 40, 40), r"painting: expected shape \[3, H, W\]"),
        (torch.rand(40, 40), r"painting: expected shape \[3, H, W\]"),
    ):
        with pytest.raises(ValueError, match=sentence):
            Style(network, wrong, 48)
    with pytest.raises(ValueError, match="layer: expected one of conv1_1"):
        Style(network, painting(), 48, layers=("conv2_3",))
    for channel in (6, -1):
        with pytest.raises(ValueError, match="channel: expected one of the 6 of conv2_1, 0 to 5"):
            Dream(network, layer="conv2_1", channel=channel)


def test_dream_losses(network: FeatureNetwork) -> None:
    images, masks, shape = torch.rand(2, 3, 32, 32), torch.ones(2, 32, 32), unmoved(ball())
    features = network(images, "conv2_1")["conv2_1"]
    found = Dream(network, layer="conv2_1").losses(images, masks, shape)
    torch.testing.assert_close(found["dream"], -features.square().mean().log(), **rounding(features.numel()))
    raw = Dream(network, layer="conv2_1", channel=3, weights=DreamWeights(0, 0, 2.0), relative=False)
    found = raw.losses(images, masks, shape)
    torch.testing.assert_close(found["dream"], -features[:, 3].square().mean(), **relative(features.numel()))
    edges = shape.vertices[shape.topology.edges]
    lengths = (edges[:, 0] - edges[:, 1]).norm(dim=1)
    # The variance of similar lengths amplifies rounding errors by the ratio of length to deviation.
    spread = float(lengths.mean() / lengths.std())
    expected = 2 * 320 * lengths.var(unbiased=False)
    torch.testing.assert_close(found["edges"], expected, **relative(int(2 * len(lengths) * spread**2)))
    greys = Dream(network, layer="conv2_1").background(4, generator(0, 3))
    assert greys.unique().numel() == 1


def test_bend() -> None:
    mesh = ball()
    start, topology = mesh.vertices.detach(), Topology.of(mesh.faces)
    assert Deformation(start + 0.3, start, topology).bend < 1e-6
    # A tenth of a length of about 0.3, of coordinates up to 1.1: 0.01 comes with 4 / 0.03 roundings.
    torch.testing.assert_close(
        Deformation(1.1 * start, start, topology).bend, torch.tensor(0.01), **relative(int(4 / 0.03) + 480)
    )
    spike = start.clone()
    spike[7] *= 1.2
    assert Deformation(spike, start, topology).bend > 1e-3
    # A small mesh beside a large one counts as much, because changes are relative to the length of each edge.
    both = Topology.of(torch.cat((mesh.faces, mesh.faces + 162)))
    pair, bent = torch.cat((start, 0.2 * start)), torch.cat((spike, 0.2 * spike))
    torch.testing.assert_close(Deformation(bent, pair, both).bend, Deformation(spike, start, topology).bend)
    flat = start.clone()
    flat[7] = flat[topology.edges[(topology.edges == 7).any(1)][0].sum() - 7]  # an edge of no length
    assert torch.isfinite(Deformation(spike, flat, topology).bend)


def test_random_views() -> None:
    views = RandomViews((20.0, 40.0))
    camera, light = views.sample(500, generator(0, 0))
    eye = camera.origin
    elevation = torch.rad2deg(torch.asin(eye[:, 1] / eye.norm(dim=1)))
    assert 20 <= elevation.min() < 21 and 39 < elevation.max() <= 40
    assert abs(eye.norm(dim=1).mean() - 2.732) < 0.02 and 0.08 < eye.norm(dim=1).std() < 0.12
    assert light is not None
    direction = torch.as_tensor(light.direction)
    torch.testing.assert_close(direction.norm(dim=1), torch.ones(500))
    torch.testing.assert_close(direction[:, 1], torch.full((500,), 0.8660254))
    again, _ = views.sample(500, generator(0, 0))
    assert torch.equal(camera.origin, again.origin)
    assert RandomViews(light=None).sample(2, generator(0, 0))[1] is None
    for wrong in ((40.0, 20.0), (-95.0, 20.0), (0.0, 90.0)):
        with pytest.raises(ValueError, match="elevation: expected two numbers between -90 and 90"):
            RandomViews(wrong)


def style_edit(network: FeatureNetwork, **options: object) -> MeshEdit:
    style = Style(network, painting(), 48)
    settings = {"steps": 40, "size": 48, "batch": 2, "texture_rate": 0.3} | options
    return MeshEdit(ball(0.05, 0.05, 0.05), style, **settings)  # type: ignore[arg-type]


def test_style_is_transferred(network: FeatureNetwork) -> None:
    edit = style_edit(network, steps=80)
    while not edit.done:
        row = edit.advance()
        parts = ("style", "content", "bend", "variation", "palette")
        assert row["loss"] == pytest.approx(sum(row[name] for name in parts), 1e-5)
    assert edit.measure() < 0.4 * edit.before
    moved = edit.displacement()
    assert 0 < moved["mean"] < moved["most"] < 0.05
    mesh = edit.mesh()
    assert mesh.textures.min() >= 0 and mesh.textures.max() <= 1
    # Gram matrices of random features do not tell orange from grey; the palette loss does.
    red, green, blue = mesh.textures.mean((0, 1, 2, 3))
    assert red > 1.3 * green and green > 1.5 * blue
    assert set(edit.seconds) == {"renderer", "network", "rest"} and min(edit.seconds.values()) > 0


def test_same_seed_same_result_and_resuming(network: FeatureNetwork) -> None:
    whole = style_edit(network, steps=6, seed=4)
    while not whole.done:
        whole.advance()
    first = style_edit(network, steps=6, seed=4)
    for _ in range(3):
        first.advance()
    state = first.state_dict()
    second = style_edit(network, steps=6, seed=4)
    second.load_state_dict(state)
    assert second.step == 3 and second.before == whole.before
    while not second.done:
        second.advance()
    for part in ("vertices", "colors"):
        assert torch.equal(whole.state_dict()[part], second.state_dict()[part])
    other = style_edit(network, steps=6, seed=5)
    while not other.done:
        other.advance()
    assert not torch.equal(whole.mesh().vertices, other.mesh().vertices)


def test_rates_of_zero_change_nothing(network: FeatureNetwork) -> None:
    for rate, still, moving in (("vertex_rate", "vertices", "colors"), ("texture_rate", "colors", "vertices")):
        edit = style_edit(network, steps=2, **{rate: 0.0})
        start = {name: edit.state_dict()[name].clone() for name in (still, moving)}
        edit.advance()
        assert torch.equal(edit.state_dict()[still], start[still])
        assert not torch.equal(edit.state_dict()[moving], start[moving])


def test_the_mesh_keeps_its_coordinates_and_colours(network: FeatureNetwork) -> None:
    mesh = ball()
    colours = torch.rand(162, 3, generator=torch.Generator().manual_seed(0)) * 0.9 + 0.05
    weights = torch.cartesian_prod(*[torch.arange(4.0)] * 3)
    weights[0] = 1
    cubes = torch.einsum("gk,fkc->fgc", weights / weights.sum(1, keepdim=True), colours[mesh.faces.long()])
    # Faces share no vertices, as in a GLB file; equal vertices move together.
    soup = mesh.vertices.detach()[mesh.faces.long()].reshape(-1, 3) * 7 + torch.tensor([100.0, -5, 3])
    own = nr.Mesh(soup, torch.arange(len(soup)).reshape(-1, 3), cubes.reshape(-1, 4, 4, 4, 3))
    edit = MeshEdit(own, Style(network, painting(), 48), steps=2, size=48, batch=1)
    torch.testing.assert_close(edit.mesh().vertices, own.vertices, **rounding(8, 107))  # normalised, and back again
    torch.testing.assert_close(edit.mesh().textures, own.textures, **rounding(64))  # means, through logit and sigmoid
    edit.advance()
    edit.advance()
    moved = edit.mesh().vertices
    assert not torch.equal(moved, own.vertices)
    places = mesh.faces.reshape(-1).long()
    first = torch.zeros(162, dtype=torch.long).index_put_((places,), torch.arange(len(places)))
    assert torch.equal(moved, moved[first[places]])
    assert own.vertices.grad is None and own.textures.grad is None


def test_unused_vertices_change_nothing(network: FeatureNetwork) -> None:
    found = []
    for extra in (torch.zeros(0, 3), torch.tensor([[9.0, 9.0, 9.0]])):
        mesh = ball(0.3, 0.3, 0.3)
        mesh = nr.Mesh(torch.cat((mesh.vertices.detach(), extra)), mesh.faces, mesh.textures.detach())
        edit = MeshEdit(mesh, Style(network, painting(), 48), steps=1, size=48, batch=1, seed=1)
        edit.advance()
        found.append((edit.mesh(), preview(edit, 64)))
    (one, picture), (other, again) = found
    assert torch.equal(one.textures, other.textures) and torch.equal(picture, again)
    assert torch.equal(other.vertices[-1], torch.tensor([9.0, 9.0, 9.0]))


def test_initial_colours_of_a_mesh_without_colours(network: FeatureNetwork) -> None:
    expected = painting().mean((1, 2))
    colours = style_edit(network, start="plain").mesh().textures
    torch.testing.assert_close(colours.mean((0, 1, 2, 3)), expected, rtol=0, atol=0.01)
    assert 0 < colours.std(0).max() < 0.03
    assert abs(style_edit(network, start="random").mesh().textures.mean() - 0.5) < 0.005


def test_hidden_texels_are_filled_from_adjacent_ones(network: FeatureNetwork) -> None:
    edit = style_edit(network)  # the cameras are above: the lowest faces are hidden
    while not edit.done:
        edit.advance()
    low = ball().vertices[ball().faces.long()][..., 1].amax(1) < -0.9
    assert low.any()
    assert (edit.state_dict()["colors"].sigmoid() < 0.0501).all(1).any()  # where ball() began, and still is
    assert (edit.mesh().textures[low] - 0.05).mean() > 0.02


def unfolded(colour: float) -> nr.UVMesh:
    """Make a ball with an image on its upper half, by longitude and height, and corner colours below."""
    mesh = ball()
    vertices, faces = mesh.vertices.detach(), mesh.faces
    corners = vertices[faces.long()]
    angle = torch.atan2(corners[..., 2], corners[..., 0]) / torch.pi / 2 + 0.5
    angle = torch.where(angle < angle.amax(1, keepdim=True) - 0.5, angle + 1, angle)
    return nr.UVMesh(
        vertices,
        faces,
        uv=torch.stack((angle, corners[..., 1] / 2 + 0.5), 2),
        image_index=torch.where(corners[..., 1].mean(1) > 0, 0, -1),
        images=(torch.full((24, 48, 3), colour),),
        colors=torch.full((len(faces), 3, 3), colour),
        wraps=("repeat",),
    )


def test_images_are_painted_where_a_mesh_has_some(network: FeatureNetwork) -> None:
    mesh = unfolded(0.1)
    views = RandomViews((-10.0, 30.0))
    edit = MeshEdit(
        mesh, Style(network, painting(), 48), views, steps=60, size=48, batch=2, texture_rate=0.2, settle=0.0
    )
    start = edit.mesh()
    assert isinstance(start, nr.UVMesh)
    torch.testing.assert_close(start.images[0], mesh.images[0])
    torch.testing.assert_close(start.vertices, mesh.vertices)
    while not edit.done:
        edit.advance()
    assert edit.measure() < 0.35 * edit.before
    found = edit.mesh()
    assert isinstance(found, nr.UVMesh) and torch.equal(found.uv, mesh.uv)
    expected = painting().mean((1, 2))
    assert (found.images[0].mean((0, 1)) - expected).abs().max() < 0.15  # all texels, also invisible ones
    upper = mesh.image_index == 0
    colours = found.colors[~upper]
    assert torch.equal(found.colors[upper], mesh.colors[upper]) and (colours > 0.12).any()
    place = found.vertices[found.faces.long()][~upper].reshape(-1, 3)  # all begin in one colour
    _, same = torch.unique(place, dim=0, return_inverse=True)
    first = torch.stack(
        [colours.reshape(-1, 3)[same == vertex].std(0, False).max() for vertex in range(same.max() + 1)]
    )
    assert first.max() < 1e-6  # a vertex has one colour
    assert torch.equal(mesh.images[0], torch.full((24, 48, 3), 0.1))  # the caller's


def test_texture_rate_zero_keeps_the_original_texture(network: FeatureNetwork) -> None:
    generator = torch.Generator().manual_seed(0)
    image, cubes = torch.rand(24, 48, 3, generator=generator), ball(1.0, 0.0, 0.5)
    painted = replace(unfolded(0.0), images=(image,), colors=torch.rand(320, 3, 3, generator=generator))
    for mesh, textures in ((painted, lambda mesh: mesh.images[0]), (cubes, lambda mesh: mesh.textures)):
        edit = MeshEdit(mesh, Style(network, painting(), 48), steps=1, size=48, batch=1, texture_rate=0.0)
        edit.advance()
        found = edit.mesh()
        assert torch.equal(textures(found), textures(mesh)) and not torch.equal(found.vertices, mesh.vertices)
        again = MeshEdit(found, Style(network, painting(), 48), steps=1, size=48, batch=1, texture_rate=0.0)
        assert edit.measure() == pytest.approx(again.measure(), rel=0.02)  # of these very colours
    assert torch.equal(edit.mesh().faces, cubes.faces)


def test_faces_without_an_image_keep_borders_between_colours(network: FeatureNetwork) -> None:
    mesh = unfolded(0.5)
    colors = torch.where(mesh.vertices[mesh.faces.long()].mean(1)[:, :1, None] > 0, 0.8, 0.2).expand(-1, 3, 3)
    start = MeshEdit(replace(mesh, colors=colors.contiguous()), Style(network, painting(), 48), size=48).mesh()
    torch.testing.assert_close(start.colors[mesh.image_index < 0], colors[mesh.image_index < 0])


def test_dream_grows(network: FeatureNetwork) -> None:
    dream = Dream(network, layer="conv3_1")
    edit = MeshEdit(
        ball(),
        dream,
        RandomViews((-10, 30), 2.5, light=None),
        steps=25,
        size=48,
        batch=2,
        texture_rate=0.1,
        start="random",
    )
    while not edit.done:
        edit.advance()
    assert edit.phase == "dream" and edit.measure() > 1.3 * edit.before


def test_dream_of_googlenet(shared: Path) -> None:
    """The paper's layer, measured on held-out views."""
    network = load_features(shared / "data" / "weights" / "googlenet_bvlc.safetensors")
    edit = MeshEdit(
        ball(), Dream(network), RandomViews((-10, 30), 2.5, light=None), steps=16, size=96, batch=1, start="random",
        texture_rate=0.15,
    )  # fmt: skip
    while not edit.done:
        edit.advance()
    assert edit.measure() > 1.5 * edit.before


@pytest.mark.slow
def test_style_with_the_distilled_network(shared: Path) -> None:
    network = load_features(shared / "data" / "weights" / "vgg19_distilled.safetensors")
    picture = nr.load_image(shared / "data" / "styles" / "munch1.jpg").permute(2, 0, 1)
    edit = MeshEdit(ball(), Style(network, picture, 96), steps=50, size=96, batch=2, start="random", texture_rate=0.1)
    while not edit.done:
        edit.advance()
    assert edit.measure() < 0.2 * edit.before


def test_what_is_refused(network: FeatureNetwork) -> None:
    for options, sentence in (
        ({"start": "white"}, 'start: expected "mesh", "plain" or "random"'),
        ({"size": 31}, "size: expected at least 32"),
        ({"steps": 0}, "steps: expected at least 1"),
        ({"batch": 0}, "batch: expected at least 1"),
        ({"texture_size": 200}, r"textures of at most 2 GiB, got 28.6 GiB \(320 faces of 200³ texels\); choose"),
        ({"vertex_rate": -1.0}, "vertex_rate: expected a number of at least 0"),
        ({"settle": 1.5}, "settle: expected a fraction in"),
        ({"texture_size": 2}, "texture_size: expected at least 3"),
        ({"texture_size": 3, "start": "mesh"}, "mesh: expected textures of 3³ texels, got 4³"),
    ):
        with pytest.raises(ValueError, match=sentence):
            style_edit(network, **options)
    point = nr.Mesh(torch.ones(3, 3), torch.tensor([[0, 1, 2]]), torch.ones(1, 4, 4, 4, 3))
    with pytest.raises(ValueError, match="faces whose vertices all coincide"):
        MeshEdit(point, Style(network, painting(), 48), size=48)
