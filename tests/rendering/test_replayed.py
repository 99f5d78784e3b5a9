"""Recorded steps equal eager ones to the bit, whatever the values are, and refuse what they cannot repeat."""

from __future__ import annotations

import copy
import random
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.raster.warp import replay

pytestmark = pytest.mark.usefixtures("deterministic")

VERTICES, FACES = nr.icosphere(1, 0.7)
GENERATOR = torch.Generator().manual_seed(0)
CUBES = torch.rand(len(FACES), 2, 2, 2, 3, generator=GENERATOR)
CORNERS = torch.rand(len(FACES), 3, 3, generator=GENERATOR)
CAMERA = nr.Camera.look_at(torch.tensor([[0.3, 0.8, -2.2], [0.0, 0.0, 2.5]]))
NOISE = torch.randn(VERTICES.shape, generator=GENERATOR)

# Other values of the vertices, for which kernels and programs take other branches.
OTHERS = {
    "moved": VERTICES + 0.1 * NOISE,
    "intersecting": VERTICES + NOISE,
    "edge-on": VERTICES * torch.tensor([0.0, 1.0, 1.0]),
    "one point": VERTICES * 0,
    "behind": VERTICES - torch.tensor([0.0, 0.0, 90.0]),
    "out of view": VERTICES + torch.tensor([90.0, 0.0, 0.0]),
    "around the camera": 4 * VERTICES,
    "far": 1e13 * VERTICES,
    "not finite": torch.where(NOISE > 2, float("nan"), VERTICES),
}


@pytest.fixture(autouse=True)
def nothing_recorded(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    replay._plans.clear()
    monkeypatch.setattr("neural_renderer.rendering.replayed._missed", 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parts that are cut
        yield
    replay._plans.clear()


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """A function that calls another one without recordings."""

    def call(function: Callable[..., Any], *args: Any) -> Any:
        with monkeypatch.context() as patch:
            patch.setattr("neural_renderer.rendering.forward.replayed", lambda *args: None)
            return function(*args)

    return call


def step(vertices: Tensor, colors: Tensor, unused: str = "", **options: Any) -> list[Any]:
    """Return images and gradients, or the message of an error."""
    leaves = [vertices.clone().requires_grad_(), colors.clone().requires_grad_()]
    mesh = (leaves[0], FACES, leaves[1]) if "rgb" in options["outputs"] else (leaves[0], FACES)
    try:
        images = vars(nr.render(mesh, CAMERA, 12, **options))
    except ValueError as error:
        return [str(error)]
    generator = torch.Generator().manual_seed(1)
    grads = {name: torch.randn(image.shape, generator=generator) for name, image in images.items()}
    if unused:
        grads[unused].zero_()
    elif "rgb" in grads:
        grads["rgb"][:, 1] = 0
    found = torch.autograd.grad([*images.values()], leaves, [*grads.values()], allow_unused=True)
    return [*images.values(), *found]


def is_recorded(**options: Any) -> bool:
    mesh = VERTICES.clone().requires_grad_(), FACES, CUBES.clone().requires_grad_()
    return "_Replay" in str(nr.render(mesh, CAMERA, 12, **options).rgb.grad_fn)


def assert_equal(found: list[Any], wanted: list[Any]) -> None:
    for one, other in zip(found, wanted, strict=True):
        if isinstance(one, Tensor):
            assert torch.equal(one.nan_to_num(nan=7.0), other.nan_to_num(nan=7.0))
        else:
            assert one == other


KINDS = {
    "silhouettes": {"outputs": ("alpha",)},
    "lit": {"outputs": ("rgb",)},
    "unlit": {"outputs": ("rgb", "alpha"), "light": None, "background": (0.2, 0.4, 0.6)},
    "all": {"outputs": ("rgb", "alpha", "depth"), "light": nr.Light(0.3, 0.7)},
    "cut": {"outputs": ("alpha", "depth"), "near": 2.0, "far": 3.0},
    "one side": {"outputs": ("rgb", "depth"), "two_sided": False, "far": 9.0},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_other_values(eager, gradient, anti_aliasing, kind):
    options = {"gradient": gradient, "anti_aliasing": anti_aliasing, **KINDS[kind]}
    # "nmr" of colours asks which channels have a gradient, so it is not recorded.
    kinds = {replay.Plan} if gradient == "edge" or kind == "silhouettes" else {bool, replay.Plan}
    for colors in (CUBES, CORNERS)[: 1 + ("rgb" in options["outputs"])]:
        for _ in range(2):
            step(VERTICES, colors, **options)
        unused = options["outputs"][-1] if len(options["outputs"]) > 1 else ""
        for vertices in OTHERS.values():
            run = partial(step, vertices, 2 * colors - 0.5, unused, **options)
            assert_equal(run(), eager(run))
    assert {*map(type, replay._plans.values())} <= kinds


@pytest.mark.parametrize("kind", ["textures", "vertex_colors", "face_colors"])
@pytest.mark.parametrize("light", [None, nr.Light(0.3, 0.7)])
def test_meshes(eager, light, kind):
    colors = {"textures": CUBES, "vertex_colors": 0.5 + VERTICES, "face_colors": CORNERS[:, 0]}[kind]
    mesh = nr.Mesh(VERTICES, FACES, **{kind: colors}).trainable()
    weights = torch.randn(2, 3, 12, 12, generator=GENERATOR)

    def run(vertices: Tensor, factor: float = 1.0, outputs: tuple[str, ...] = ("rgb", "alpha")) -> list[Any]:
        with torch.no_grad():
            mesh.vertices.copy_(vertices)
            getattr(mesh, kind).copy_(factor * colors)
        try:
            images = nr.render(mesh, CAMERA, 12, outputs=outputs, light=light)
        except ValueError as error:
            return [str(error)]
        loss = (weights * images.rgb).sum() if "rgb" in outputs else images.alpha.square().sum()
        found = torch.autograd.grad(loss, list(mesh.parameters()), allow_unused=True)
        return [*vars(images).values(), *found]

    for _ in range(2):
        run(VERTICES)
    for vertices in (OTHERS["intersecting"], OTHERS["behind"], OTHERS["not finite"]):
        assert_equal(run(vertices, 2.0), eager(run, vertices, 2.0))
    assert_equal(run(VERTICES, float("nan")), eager(run, VERTICES, float("nan")))
    [drawn] = replay._plans.values()
    for _ in range(3):
        found = run(VERTICES, 1.0, ("alpha",))
    assert_equal(found, eager(run, VERTICES, 1.0, ("alpha",)))
    assert {*map(type, (drawn, *replay._plans.values()))} == {replay.Plan}


def test_constants_count(eager):
    """Equal ones are found again in other objects, and others are not taken for them."""
    options: dict[str, Any] = {"outputs": ("rgb",), "light": nr.Light(0.5, 0.5)}
    for _ in range(2):
        step(VERTICES, CUBES, **options)
    assert is_recorded(**options) and is_recorded(outputs=("rgb",), light=nr.Light(0.5, 0.5))
    for other in ({"light": nr.Light(0.5, 0.6)}, {"near": 2.0}, {"background": 0.1}, {"two_sided": False}):
        run = partial(step, VERTICES, CUBES, **options | other)
        assert_equal(run(), eager(run))
    direction = torch.tensor([0.0, 1.0, 0.0])
    run = partial(step, VERTICES, CUBES, outputs=("rgb",), light=nr.Light(0.5, 0.5, direction=direction))
    for _ in range(3):
        assert_equal(run(), eager(run))
    direction.data[0] = 1.0
    assert_equal(run(), eager(run))


def test_constants_may_change_in_place(eager):
    """A recording keeps the values that it was made with, also for other tensors that are equal to them."""
    eye, other = (0.3, 0.8, -2.2), (2.0, 0.8, 1.2)
    camera, faces = nr.Camera.look_at(eye), FACES.clone()

    def run(camera: nr.Camera, faces: Tensor) -> list[Any]:
        return [nr.render((VERTICES, faces), camera, 12, outputs=("alpha",)).alpha]

    for _ in range(3):
        wanted = run(camera, faces)
    for name, value in vars(nr.Camera.look_at(other)).items():
        if isinstance(value, Tensor):
            getattr(camera, name).copy_(value)
    faces.copy_(faces.roll(1, 0) * (torch.arange(len(faces)) % 2)[:, None])
    assert_equal(run(camera, faces), eager(run, camera, faces))
    assert not torch.equal(run(camera, faces)[0], wanted[0])
    for _ in range(3):
        assert_equal(run(nr.Camera.look_at(eye), FACES.clone()), wanted)


def random_scene(rng: random.Random) -> dict[str, Any]:
    """Make constants of a step: a camera with up to four views, faces and options."""
    generator = torch.Generator().manual_seed(rng.randrange(1 << 30))
    count = rng.choice([1, 2, 3, 3, 4])
    angles = 360 * torch.rand(count, generator=generator)
    camera = nr.Camera.look_at(nr.get_points_from_angles(rng.uniform(1.5, 4.0), rng.uniform(-80.0, 80.0), angles))
    light = rng.choice([None, nr.CameraLight(), nr.Light(0.2, 0.7, direction=torch.rand(3, generator=generator) + 0.1)])
    return {
        "camera": camera.with_K(12) if rng.random() < 0.5 else camera,
        "faces": nr.icosphere(1)[1].clone(),
        "background": rng.choice([0.3, torch.rand(3, generator=generator), torch.rand(count, 3, generator=generator)]),
        "light": light,
        "outputs": rng.choice([("alpha",), ("rgb",), ("rgb", "alpha", "depth"), ("alpha", "depth")]),
        "gradient": rng.choice(["edge", "edge", "nmr"]),
        "anti_aliasing": rng.random() < 0.5,
        "near": rng.choice([None, 1.5]),
    }


def change(scene: dict[str, Any], rng: random.Random) -> None:
    """Change a constant of a scene in place."""
    owners = [vars(scene["camera"]), scene, vars(scene["light"]) if scene["light"] else {}]
    value = rng.choice([value for owner in owners for value in owner.values() if isinstance(value, Tensor)])
    value.copy_(value.flip(0) if value is scene["faces"] else 1.1 * value)


@pytest.mark.parametrize("seed", range(3))
def test_random_steps(eager, seed):
    """Steps with equal, changed and copied constants, in any order."""
    rng = random.Random(seed)
    replays = 0
    for _ in range(8):
        first = random_scene(rng)
        changed = copy.deepcopy(first)
        for number in range(8):
            if number > 3:
                change(changed, rng)
            scene = copy.deepcopy(first) if rng.random() < 0.6 else changed
            leaf = (VERTICES + 0.1 * (number > 2) * NOISE).requires_grad_()
            colors = [(rng.random() * CUBES).requires_grad_()] if "rgb" in scene["outputs"] else []

            def run(scene: dict[str, Any] = scene, leaf: Tensor = leaf, colors: list[Tensor] = colors) -> list[Any]:
                options = dict(scene)
                camera, faces = options.pop("camera"), options.pop("faces")
                images = [*vars(nr.render((leaf, faces, *colors), camera, 12, **options)).values()]
                found = torch.autograd.grad(sum(each.square().sum() for each in images), [leaf, *colors])
                return [*images, *found]

            found = run()
            replays += "_Replay" in str(found[0].grad_fn)
            assert_equal(found, eager(run))
    assert replays > 8


def recorded_step(vertices: Tensor, outputs: tuple[str, ...] = ("alpha",)) -> Tensor:
    for _ in range(3):
        image = nr.render((vertices, FACES), CAMERA, 12, outputs=outputs, far=9.0).alpha
    assert "_Replay" in str(image.grad_fn)
    return image


def test_steps_share_no_memory():
    leaf, other = VERTICES.clone().requires_grad_(), OTHERS["moved"].clone().requires_grad_()
    wanted = [torch.autograd.grad(recorded_step(each).square().sum(), each)[0] for each in (leaf, other)]
    images = [recorded_step(each) for each in (leaf, other)]
    found = [torch.autograd.grad(image.square().sum(), each) for image, each in zip(images, (leaf, other), strict=True)]
    assert all(torch.equal(one, two) for (one,), two in zip(found, wanted, strict=True))


def test_backward_twice():
    leaf = VERTICES.clone().requires_grad_()
    loss = recorded_step(leaf).square().sum()
    first, second = (torch.autograd.grad(loss, leaf, retain_graph=True)[0] for _ in range(2))
    assert torch.equal(first, second)
    torch.autograd.grad(loss, leaf)
    with pytest.raises(RuntimeError, match="second time"):
        torch.autograd.grad(loss, leaf)


def test_second_derivatives():
    leaf, colors = VERTICES.clone().requires_grad_(), CUBES.clone().requires_grad_()
    (slope,) = torch.autograd.grad(recorded_step(leaf).square().sum(), leaf, create_graph=True)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        slope.sum().backward()
    for _ in range(3):
        image = nr.render((VERTICES, FACES, colors), CAMERA, 12, outputs=("rgb",), light=None).rgb
    assert "_Replay" in str(image.grad_fn)
    (slope,) = torch.autograd.grad(image.square().sum(), colors, create_graph=True)
    (second,) = torch.autograd.grad(slope.sum(), colors)
    assert second.abs().sum() > 0


def test_changes_in_place():
    leaf = VERTICES.clone().requires_grad_()
    image = recorded_step(leaf)
    wanted = torch.autograd.grad((0.5 * image).sum(), leaf, retain_graph=True)[0]
    image.mul_(0.5)
    assert torch.equal(torch.autograd.grad(image.sum(), leaf)[0], wanted)
    image = recorded_step(leaf)
    with torch.no_grad():
        leaf.add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_threads(eager):
    leaves = [(VERTICES + 0.02 * k * NOISE).requires_grad_() for k in range(4)]
    recorded_step(leaves[0])
    found: dict[int, list[Tensor]] = {}

    def work(k: int) -> None:
        found[k] = [torch.autograd.grad(recorded_step(leaves[k]).square().sum(), leaves[k])[0] for _ in range(5)]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for action in (threading.Thread.start, threading.Thread.join):
        for each in threads:
            action(each)
    for leaf, several in zip(leaves, (found[k] for k in range(4)), strict=True):
        image = eager(partial(nr.render, (leaf, FACES), CAMERA, 12, outputs=("alpha",), far=9.0)).alpha
        (wanted,) = torch.autograd.grad(image.square().sum(), leaf)
        assert all(torch.equal(wanted, each) for each in several)


def test_where_nothing_is_recorded():
    leaf = VERTICES.clone().requires_grad_()
    recorded_step(leaf)

    def is_replayed() -> bool:
        return "_Replay" in str(nr.render((leaf, FACES), CAMERA, 12, outputs=("alpha",), far=9.0).alpha.grad_fn)

    assert is_replayed()
    with torch.autograd.graph.saved_tensors_hooks(lambda each: each, lambda each: each):
        assert not is_replayed()
    with torch.autocast("cpu", torch.bfloat16), torch.no_grad():
        nr.render((leaf, FACES), CAMERA, 12, outputs=("alpha",), far=9.0)
    with torch.no_grad():
        images = [nr.render((leaf, FACES), CAMERA, 12, outputs=("alpha",)).alpha for _ in range(4)]
    assert all(torch.equal(images[0], each) and not each.requires_grad for each in images)


READS = {
    "float": lambda value: value * float(value.sum()),
    "if": lambda value: value * 2 if value.sum() > 0 else value * 3,
    "numpy": lambda value: value * torch.from_numpy(value.detach().numpy().copy()),
    "dlpack": lambda value: value * torch.from_dlpack(value.detach()),
    "list": lambda value: value * torch.tensor(value.tolist()),
    "equal": lambda value: value * torch.equal(value, value),
    "part": lambda value: value[:1],
    "in place": lambda value: value.detach().mul_(2.0),
}


@pytest.mark.parametrize("name", READS)
def test_what_cannot_be_repeated_is_refused(name):
    inputs = (torch.rand(3, generator=GENERATOR),)
    for _ in range(3):
        assert replay.replay(lambda: lambda value: (READS[name](value),), inputs, lambda: name) is None
    assert [*replay._plans.values()] == [False]


VIEWS = {
    "of a constant": lambda value: (value + torch.eye(3)[2].expand(3, 3),),
    "of an input": lambda value: (value - value.mT,),
    "of a result": lambda value: (value * (2 * value).mT,),
}


@pytest.mark.parametrize("name", VIEWS)
def test_views_of_the_same_shape(name):
    """A view with the shape of the whole tensor, but other strides, is not taken for it."""
    inputs = (torch.rand(3, 3, generator=GENERATOR),)
    found = [replay.replay(lambda: VIEWS[name], inputs, lambda: name) for _ in range(3)]
    assert found[2] is not None and torch.equal(found[2][0], VIEWS[name](*inputs)[0])


def test_constants_of_large_steps_are_not_read():
    large = torch.zeros(1 << 15, 2)
    assert replay.replay(pytest.fail, (large,), pytest.fail) is None
