"""Feature networks: activations, checkpoints and rejected files."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from safetensors.torch import save_file
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.features import FeatureNetwork, features_like, load_features
from neural_renderer.apps.common.pictures.photograph import photograph
from tests.rounding import relative, rounding

PLANS = {16: (2, 2, 3, 3, 3), 19: (2, 2, 4, 4, 4)}
BLOCKS = ("3a", "3b", "4a", "4b", "4c", "4d", "4e", "5a", "5b")


def torchvision_vgg(depth: int, classes: int | None = 7, width: int = 4) -> dict[str, Tensor]:
    """Make random weights of a narrow VGG under torchvision's names."""
    generator = torch.Generator().manual_seed(0)
    found: dict[str, Tensor] = {}
    index, inputs = 0, 3
    for convolutions in PLANS[depth]:
        for _ in range(convolutions):
            found[f"features.{index}.weight"] = torch.randn(width, inputs, 3, 3, generator=generator) * 0.3
            found[f"features.{index}.bias"] = torch.randn(width, generator=generator) * 0.1
            index, inputs = index + 2, width
        index += 1
    for place, (out, into) in {0: (6, width * 49), 3: (5, 6), 6: (classes or 3, 5)}.items():
        found[f"classifier.{place}.weight"] = torch.randn(out, into, generator=generator) * 0.1
        found[f"classifier.{place}.bias"] = torch.full((out,), torch.nan if classes is None else 0.1)
    return found


def torchvision_googlenet() -> dict[str, Tensor]:
    """Make random weights of a narrow GoogLeNet under torchvision's names."""
    generator = torch.Generator().manual_seed(0)
    found: dict[str, Tensor] = {}

    def add(name: str, out: int, inputs: int, side: int) -> None:
        found[f"{name}.conv.weight"] = torch.randn(out, inputs, side, side, generator=generator) / side
        for part in ("weight", "bias", "running_mean"):
            found[f"{name}.bn.{part}"] = torch.randn(out, generator=generator)
        found[f"{name}.bn.running_var"] = torch.rand(out, generator=generator) + 0.5
        found[f"{name}.bn.num_batches_tracked"] = torch.tensor(1)

    for name, shape in {"conv1": (4, 3, 7), "conv2": (4, 4, 1), "conv3": (6, 4, 3), "aux1.conv": (2, 4, 1)}.items():
        add(name, *shape)
    width = 6
    for block in BLOCKS:
        for branch, out, inputs, side in (
            ("branch1", 2, width, 1), ("branch2.0", 3, width, 1), ("branch2.1", 4, 3, 3),
            ("branch3.0", 2, width, 1), ("branch3.1", 3, 2, 3), ("branch4.1", 1, width, 1),
        ):  # fmt: skip
            add(f"inception{block}.{branch}", out, inputs, side)
        width = 10
    return found | {"fc.weight": torch.randn(5, 10, generator=generator), "fc.bias": torch.zeros(5)}


def images(size: int = 64) -> Tensor:
    return torch.rand(2, 3, size, size, generator=torch.Generator().manual_seed(1))


def load(weights: dict[str, Tensor], folder: Path) -> FeatureNetwork:
    torch.save(weights, folder / "weights.pth")
    return load_features(folder / "weights.pth")


@pytest.mark.parametrize("depth", [16, 19])
def test_vgg_of_torchvision(depth: int, tmp_path: Path) -> None:
    weights = torchvision_vgg(depth)
    network = load(weights, tmp_path)
    assert network.name == f"VGG-{depth}" and len(network.layers) == depth + 5
    mean, std = (torch.tensor(row)[:, None, None] for row in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
    values = (images() - mean) / std
    expected = {}
    index = 0
    for block, convolutions in enumerate(PLANS[depth], 1):
        for place in range(1, convolutions + 1):
            kernel, bias = weights[f"features.{index}.weight"], weights[f"features.{index}.bias"]
            values = expected[f"conv{block}_{place}"] = F.conv2d(values, kernel, bias, padding=1).relu()
            index += 2
        index += 1
        values = expected[f"pool{block}"] = F.max_pool2d(values, 2)
    values = F.adaptive_avg_pool2d(values, 7).flatten(1)
    for name, place in (("fc6", 0), ("fc7", 3), ("fc8", 6)):
        values = F.linear(values, weights[f"classifier.{place}.weight"], weights[f"classifier.{place}.bias"])
        values = expected[name] = values if name == "fc8" else values.relu()
    found = network(images(), network.layers)
    assert list(found) == list(expected) == list(network.layers)
    for name, value in expected.items():
        # At most 19 layers of 37 terms, whose sizes the weights keep within a few times those of the sums.
        torch.testing.assert_close(found[name], value, **rounding(4 * 19 * 37, float(value.abs().max())))


def test_vgg_whose_classifier_is_missing_takes_grey_levels(tmp_path: Path) -> None:
    weights = torchvision_vgg(16, classes=None)
    network = load(weights, tmp_path)
    assert "fc6" not in network.layers and network.layers[-1] == "pool5"
    grey = 255 * images() - torch.tensor([123.68, 116.779, 103.939])[:, None, None]
    expected = F.conv2d(grey, weights["features.0.weight"], weights["features.0.bias"], padding=1).relu()
    # 27 terms, of pixels up to 151 and weights that hardly exceed 1.
    torch.testing.assert_close(network(images(), ["conv1_1"])["conv1_1"], expected, **rounding(2 * 27, 27 * 151))


def test_vgg_by_names(tmp_path: Path) -> None:
    plain = torchvision_vgg(16)
    names = iter([f"conv{block}_{place}" for block, n in enumerate(PLANS[16], 1) for place in range(1, n + 1)])
    weights: dict[str, Tensor] = {}
    for key in plain:
        if key.startswith("features") and key.endswith("weight"):
            name = next(names)
            weights |= {f"{name}.weight": plain[key], f"{name}.bias": plain[key.replace("weight", "bias")]}
    network = load(weights, tmp_path)
    grey = 255 * images().flip(1) - torch.tensor([103.939, 116.779, 123.68])[:, None, None]
    expected = F.conv2d(grey, plain["features.0.weight"], plain["features.0.bias"], padding=1).relu()
    assert network.name == "VGG-16"
    torch.testing.assert_close(network(images(), "conv1_1")["conv1_1"], expected, **rounding(2 * 27, 27 * 151))


def test_googlenet_of_torchvision(tmp_path: Path) -> None:
    weights = torchvision_googlenet()
    network = load(weights, tmp_path)

    def unit(name: str, values: Tensor, stride: int = 1) -> Tensor:
        kernel = weights[f"{name}.conv.weight"]
        values = F.conv2d(values, kernel, stride=stride, padding=kernel.shape[-1] // 2)
        mean, var, gain, bias = (
            weights[f"{name}.bn.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return F.batch_norm(values, mean, var, gain, bias, eps=1e-3).relu()

    values = unit("conv1", 2 * images() - 1, stride=2)
    values = unit("conv3", unit("conv2", F.max_pool2d(values, 3, 2, ceil_mode=True)))
    values = F.max_pool2d(values, 3, 2, ceil_mode=True)
    for block in BLOCKS:
        branch = f"inception{block}.branch"
        pooled = unit(f"{branch}4.1", F.max_pool2d(values, 3, 1, 1))
        towers = [unit(f"{branch}{n}.1", unit(f"{branch}{n}.0", values)) for n in (2, 3)]
        values = torch.cat((unit(f"{branch}1", values), *towers, pooled), 1)
        if block in ("3b", "4e"):
            values = F.max_pool2d(values, 3 if block == "3b" else 2, 2, ceil_mode=True)
    expected = F.linear(values.mean((2, 3)), weights["fc.weight"], weights["fc.bias"])
    # 21 units of up to 148 terms, and normalisation, which divides by deviations of 0.7 and more.
    found = network(images(), ["classifier"])["classifier"]
    torch.testing.assert_close(found, expected, **rounding(4 * 21 * 148, float(expected.abs().max())))


def test_googlenet_knows_a_teapot_and_the_sea(shared: Path) -> None:
    network = load_features(shared / "data" / "weights" / "googlenet_bvlc.safetensors")
    teapot = photograph(nr.Mesh.load(shared / "data" / "meshes" / "standard" / "teapot_kato.obj").normalize(), 140)
    painting = nr.load_image(shared / "data" / "styles" / "monet2.jpg").permute(2, 0, 1)
    pictures = [F.interpolate(picture[None], (224, 224), mode="area") for picture in (teapot, painting)]
    found = network(torch.cat(pictures), ["inception_4c", "pool5", "classifier"])
    assert found["inception_4c"].shape == (2, 512, 14, 14) and found["pool5"].shape == (2, 1024)
    probability = found["classifier"].softmax(1)
    assert probability[0].argmax() == 849 and probability[0, 849] > 0.9  # ImageNet's "teapot"
    # "alp", "cliff", "lakeside", "promontory", "seashore", "valley": a landscape
    assert probability[1, [970, 972, 975, 976, 978, 979]].sum() > 0.4


def test_local_response_normalisation() -> None:
    from neural_renderer.apps.common.features.googlenet import LocalResponse

    values = 300 * torch.randn(2, 9, 4, 5, generator=torch.Generator().manual_seed(0))
    expected = F.local_response_norm(values, 5, 1e-4, 0.75, 1.0)
    torch.testing.assert_close(LocalResponse()(values), expected, **relative(24))  # five squares, a power, a quotient
    for channels in (1, 2, 9):
        values = (30 * torch.randn(2, channels, 3, 4, dtype=torch.float64)).requires_grad_()
        assert torch.autograd.gradcheck(LocalResponse(), values)


def test_distilled_vgg(shared: Path) -> None:
    network = load_features(shared / "data" / "weights" / "vgg19_distilled.safetensors")
    assert network.name == "VGG-19" and network.layers[-1] == "conv5_1" and "conv4_4" in network.layers
    pixels = images().requires_grad_()
    found = network(pixels, ["conv1_2", "conv4_3"])
    assert found["conv1_2"].shape == (2, 16, 64, 64) and found["conv4_3"].shape == (2, 128, 8, 8)
    # Reflection at the border: a plain image has plain features.
    plain = network(torch.full((1, 3, 32, 32), 0.3), ["conv2_2"])["conv2_2"]
    same = plain[..., :1, :1].expand_as(plain)  # up to the order of 9 x 32 terms in three layers
    torch.testing.assert_close(plain, same, **rounding(3 * 9 * 32, float(plain.abs().max())))
    found["conv4_3"].sum().backward()
    assert pixels.grad is not None and pixels.grad.abs().sum() > 0
    assert not any(parameter.requires_grad for parameter in network.parameters())


def test_only_what_is_needed_is_computed(tmp_path: Path) -> None:
    network = load(torchvision_vgg(16), tmp_path)
    network._stages["conv2_1"].register_forward_hook(lambda *_: pytest.fail("computed behind the last layer"))
    assert list(network(images(), ["conv1_1", "conv1_2"])) == ["conv1_1", "conv1_2"]
    for layers in (["conv2_3"], [], ["fc9"]):
        with pytest.raises(ValueError, match=r"layer: expected one of conv1_1, conv1_2, .* of VGG-16, got"):
            network(images(), layers)
    with pytest.raises(ValueError, match="images: expected shape"):
        network(images()[:, :2], ["conv1_1"])


def test_files_that_are_refused(tmp_path: Path) -> None:
    weights = torchvision_vgg(16)
    save_file(weights, tmp_path / "good.safetensors")
    assert load_features(tmp_path / "good.safetensors").name == "VGG-16"
    whole = (tmp_path / "good.safetensors").read_bytes()
    torch.save(weights, tmp_path / "good.pth")
    for name, data in {
        "cut.safetensors": whole[: len(whole) // 2],
        "cut.pth": (tmp_path / "good.pth").read_bytes()[:3000],
        "text.pth": b"no weights",
        "text.safetensors": b"no weights",
        "empty.pth": b"",
    }.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ValueError, match=rf"{name}: expected a (PyTorch checkpoint|\.safetensors file), .* cannot"):
            load_features(tmp_path / name)
    for name, content, sentence in (
        ("other", {"layer1.0.conv1.weight": torch.ones(3)}, "expected the weights of a VGG .* got tensors with other"),
        ("list", [torch.ones(3)], "expected a state_dict, got a list"),
        ("gap", {k: v for k, v in weights.items() if "features.5." not in k}, "expected convolutions two or three"),
        (
            "width",
            weights | {"features.5.weight": torch.ones(4, 9, 3, 3)},
            r"features.5.weight of shape \[·, 4, 3, 3\]",
        ),
        ("half", {k: v for k, v in weights.items() if k != "features.5.bias"}, "weight and bias of features.5"),
        ("bn", weights | {"features.1.running_mean": torch.ones(4)}, "VGG without batch normalisation"),
        ("fc", {k: v for k, v in weights.items() if k != "classifier.3.bias"}, "weight and bias of classifier.3"),
        ("nan", weights | {"features.5.bias": torch.full((4,), torch.nan)}, "got NaN or infinity in conv2_1"),
    ):
        torch.save(content, tmp_path / f"{name}.pth")
        with pytest.raises(ValueError, match=rf"{name}.pth: .*{sentence}"):
            load_features(tmp_path / f"{name}.pth")
    google = torchvision_googlenet()
    for name, content, sentence in (
        ("g1", {k: v for k, v in google.items() if "inception4c.branch2.1.bn" not in k}, "inception4c.branch2.1 with"),
        ("g2", google | {"conv3.conv.weight": torch.ones(6, 5, 3, 3)}, "conv2.3x3.weight of shape"),
        ("g3", {k: v for k, v in google.items() if k != "fc.weight"}, "weight and bias of loss3.classifier, got"),
    ):
        torch.save(content, tmp_path / f"{name}.pth")
        with pytest.raises(ValueError, match=rf"{name}.pth: .*{sentence}"):
            load_features(tmp_path / f"{name}.pth")
    for name, content in (("text", b"text"), ("empty", b"")):
        (tmp_path / f"{name}.pth").write_bytes(content)
        with pytest.raises(ValueError, match=rf"{name}.pth: .* got a file that cannot be read \(unknown format\)$"):
            load_features(tmp_path / f"{name}.pth")
    with pytest.raises(FileNotFoundError, match="expected a file"):
        load_features(tmp_path / "missing.pth")


def test_code_in_a_checkpoint_is_not_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self):  # what a pickle would call on loading
            return Path.touch, (tmp_path / "trapped",)

    torch.save({"features.0.weight": Trap()}, tmp_path / "trap.pth")
    with pytest.raises(ValueError, match="cannot be read"):
        load_features(tmp_path / "trap.pth")
    assert not (tmp_path / "trapped").exists()


def test_published_checkpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, dict]] = []

    def fetch(address: str, **options: object) -> dict[str, Tensor]:
        asked.append((address, options))
        return torchvision_vgg(16)

    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", fetch)
    assert load_features("vgg16").name == "VGG-16"
    address, options = asked[0]
    assert address == "https://download.pytorch.org/models/vgg16-397923af.pth"
    assert options["check_hash"] and options["weights_only"] and options["progress"]

    def offline(address: str, **options: object) -> dict[str, Tensor]:
        raise OSError("no route to host")

    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", offline)
    with pytest.raises(ConnectionError, match=r"googlenet-1378be20.pth cannot be downloaded .* the path of the file"):
        load_features("googlenet")


@pytest.mark.parametrize("weights", [torchvision_googlenet(), torchvision_vgg(16), torchvision_vgg(16, classes=None)])
def test_a_part_and_a_plan(weights: dict[str, Tensor], tmp_path: Path) -> None:
    """A truncated network is rebuilt from its plan and state_dict, without the original file."""
    network = load(weights, tmp_path)
    layer = network.layers[6]
    part = network.until(layer)
    assert part.layers == network.layers[:7] and part.name == network.name
    again = features_like(part.plan).until(layer)
    assert not torch.equal(again(images(), [layer])[layer], network(images(), [layer])[layer])
    again.load_state_dict(part.state_dict())
    for copy in (part, again):
        torch.testing.assert_close(copy(images(), [layer])[layer], network(images(), [layer])[layer], rtol=0, atol=0)
    with pytest.raises(ValueError, match="layer: expected one of conv1"):
        network.until("conv9")
    with pytest.raises(ValueError, match="plan: expected the weights of a VGG"):
        features_like({"weight": (3, 3)})


@pytest.mark.parametrize("weights", [torchvision_googlenet(), torchvision_vgg(16)])
def test_small_images(weights: dict[str, Tensor], tmp_path: Path) -> None:
    network = load(weights, tmp_path)
    assert network(images(32), network.layers)
    with pytest.raises(ValueError, match=r"images: expected larger ones for the layer pool\d, got 2 x 2"):
        network(images(2), network.layers)
