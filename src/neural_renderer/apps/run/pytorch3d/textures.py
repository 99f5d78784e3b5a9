"""`TexturesVertex` and `TexturesUV`: colours of vertices, and images with texture coordinates."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from .ops import interpolate_face_attributes

if TYPE_CHECKING:
    from typing_extensions import Self


class _Textures:
    """Lists of tensors, one for each mesh, under the names in ``_names``."""

    _names: tuple[str, ...]
    _counted: str

    def fit(self, meshes: Any) -> None:
        """Raise ValueError unless there is a texture for each mesh."""
        if len(self) != len(meshes):
            raise ValueError(f"textures: expected {len(meshes)}, one for each mesh, got {len(self)}")

    def each(self, change: Callable[[Tensor], Tensor]) -> Self:
        return self._with({name: [change(value) for value in getattr(self, name)] for name in self._names})

    def clone(self) -> Self:
        return self.each(Tensor.clone)

    def detach(self) -> Self:
        return self.each(Tensor.detach)

    def to(self, device: Any) -> Self:
        return self.each(lambda value: value.to(device))

    def extend(self, N: int) -> Self:
        return self[[i for i in range(len(self)) for _ in range(N)]]

    def join_batch(self, textures: Sequence[Self]) -> Self:
        return self._with({n: [v for each in (self, *textures) for v in getattr(each, n)] for n in self._names})

    def join_scene(self) -> Self:
        raise NotImplementedError(f"{type(self).__name__}.join_scene: expected colours of vertices")

    @property
    def _counts(self) -> list[int]:
        return [len(value) for value in getattr(self, self._counted)]

    @_counts.setter
    def _counts(self, counts: Any) -> None:
        """Do nothing: programs set counts after they changed the tensors, which have them."""

    _num_faces_per_mesh = _num_verts_per_mesh = _counts

    def __len__(self) -> int:
        return len(getattr(self, self._names[0]))

    def __getitem__(self, index: Any) -> Self:
        rows = index if isinstance(index, list) else torch.atleast_1d(torch.arange(len(self))[index]).tolist()
        return self._with({name: [getattr(self, name)[i] for i in rows] for name in self._names})

    def _with(self, values: dict[str, list[Tensor]]) -> Self:
        made = copy.copy(self)
        vars(made).update(values)
        return made


class TexturesVertex(_Textures):
    """Colours or other features of vertices, [N, V, C] or a list of [V, C]."""

    _names, _counted = ("_features",), "_features"

    def __init__(self, verts_features: Any) -> None:
        self._features = [*verts_features]

    def fit(self, meshes: Any) -> None:
        super().fit(meshes)
        pairs = zip(self._features, meshes.verts_list(), strict=True)
        self._features = [features[: len(verts)] for features, verts in pairs]

    def verts_features_list(self) -> list[Tensor]:
        return self._features

    def verts_features_packed(self) -> Tensor:
        return torch.cat(self._features)

    def verts_features_padded(self) -> Tensor:
        return pad_sequence(self._features, batch_first=True)

    def join_scene(self) -> TexturesVertex:
        return TexturesVertex([self.verts_features_packed()])

    def sample_textures(self, fragments: Any, faces_packed: Tensor) -> Tensor:
        corners = self.verts_features_packed()[faces_packed]
        return interpolate_face_attributes(fragments.pix_to_face, fragments.bary_coords, corners)


class TexturesUV(_Textures):
    """Images [H, W, C], row 0 at the top, and texture coordinates with v up, read by `torch.nn.functional.grid_sample`.

    With ``align_corners``, the coordinates 0 and 1 are the centres of the outermost pixels.
    """

    _names, _counted = ("_maps", "_faces_uvs", "_verts_uvs"), "_faces_uvs"

    def __init__(
        self, maps: Any, faces_uvs: Any, verts_uvs: Any, *, maps_ids: Any = None, padding_mode: str = "border",
        align_corners: bool = True, sampling_mode: str = "bilinear",
    ) -> None:  # fmt: skip
        if maps_ids is not None:
            raise NotImplementedError("TexturesUV(maps_ids=…): neural-renderer run has one image for each mesh only")
        self._maps, self._faces_uvs, self._verts_uvs = [*maps], [*faces_uvs], [*verts_uvs]
        self.padding_mode, self.align_corners, self.sampling_mode = padding_mode, align_corners, sampling_mode

    def fit(self, meshes: Any) -> None:
        super().fit(meshes)
        pairs = zip(self._faces_uvs, meshes.faces_list(), strict=True)
        self._faces_uvs = [uvs[: len(faces)].long() for uvs, faces in pairs]

    def maps_list(self) -> list[Tensor]:
        return self._maps

    def maps_padded(self) -> Tensor:
        """Return the images as [N, H, W, C], smaller ones enlarged to the largest size."""
        sizes = {tuple(each.shape[:2]) for each in self._maps}
        size = tuple(map(max, zip(*sizes, strict=True)))
        options: dict[str, Any] = {"size": size, "mode": "bilinear", "align_corners": self.align_corners}
        one_size = [
            each if tuple(each.shape[:2]) == size
            else functional.interpolate(each.movedim(-1, 0)[None], **options)[0].movedim(0, -1)
            for each in self._maps
        ]  # fmt: skip
        return torch.stack(one_size)

    def faces_uvs_list(self) -> list[Tensor]:
        return self._faces_uvs

    def verts_uvs_list(self) -> list[Tensor]:
        return self._verts_uvs

    def faces_verts_textures_packed(self) -> Tensor:
        """Return the colours of the corners of all faces, [F, 3, C]."""
        parts = []
        for image, faces, uvs in zip(self._maps, self._faces_uvs, self._verts_uvs, strict=True):
            parts.append(self._sampled(image[None], uvs[faces][None])[0])
        return torch.cat(parts)

    def faces_uvs_padded(self) -> Tensor:
        return pad_sequence(self._faces_uvs, batch_first=True, padding_value=-1)

    def verts_uvs_padded(self) -> Tensor:
        return pad_sequence(self._verts_uvs, batch_first=True)

    def sample_textures(self, fragments: Any, faces_packed: Tensor | None = None) -> Tensor:
        corners = torch.cat([uvs[faces] for uvs, faces in zip(self._verts_uvs, self._faces_uvs, strict=True)])
        uv = interpolate_face_attributes(fragments.pix_to_face, fragments.bary_coords, corners)
        return self._sampled(self.maps_padded(), uv.flatten(2, 3)).view(*uv.shape[:-1], -1)

    def _sampled(self, images: Tensor, uv: Tensor) -> Tensor:
        """Read images [N, H, W, C] at coordinates [N, A, B, 2], [N, A, B, C]."""
        places = (2 * uv - 1) * uv.new_tensor([1.0, -1.0])
        options: dict[str, Any] = {"padding_mode": self.padding_mode, "align_corners": self.align_corners}
        texels = functional.grid_sample(images.movedim(-1, 1).to(uv), places, self.sampling_mode, **options)
        return texels.movedim(1, -1)
