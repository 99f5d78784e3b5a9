"""An independent reader of glTF 2.0, written from the specification in plain numpy: triangles, bounds and colours.

It shares no code with the package. It is slow and checks little: it is for files that follow the specification, and
raises any error for others. Numbers of sections are those of the specification of glTF 2.0.1.
"""

from __future__ import annotations

import base64
import io
import json
import struct
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from PIL import Image

DTYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
MOST = 1 << 24  # elements of an array; a damaged file can ask for any number
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
KNOWN = {
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "KHR_materials_unlit",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_emissive_strength",
    "KHR_materials_variants",
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "EXT_mesh_gpu_instancing",
    "KHR_node_visibility",
}


class Unsupported(Exception):
    """What this reader does not know, by the extension that a file requires."""


@dataclass
class Look:
    """How the triangles of a primitive are coloured, in linear light."""

    factor: np.ndarray  # [4]
    picture: np.ndarray | None  # [H, W, 4] uint8
    wrap: tuple[int, int]
    unlit: bool


@dataclass
class Triangles:
    """Triangles of one primitive."""

    corners: np.ndarray  # [F, 3, 3], in the world
    uv: np.ndarray | None  # [F, 3, 2], v down, with the transform
    colors: np.ndarray | None  # [F, 3, 4], linear
    look: Look


class Scene:
    """All triangles that the scene of a file draws."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        content = self.path.read_bytes()
        self.binary: bytes | None = None
        if content[:4] == b"glTF":
            (length,) = struct.unpack_from("<I", content, 12)
            text, place = content[20 : 20 + length], 20 + length
            while place + 8 <= len(content):
                size, kind = struct.unpack_from("<I4s", content, place)
                if kind == b"BIN\0" and self.binary is None:
                    self.binary = content[place + 8 : place + 8 + size]
                place += 8 + size
        else:
            text = content
        self.json: dict[str, Any] = json.loads(text)
        missing = set(self.json.get("extensionsRequired", ())) - KNOWN
        if missing:
            raise Unsupported(", ".join(sorted(missing)))
        self.parts: list[Triangles] = []
        self.left_out = 0  # primitives of points and lines
        self._pictures: dict[int, np.ndarray | None] = {}
        self._parents = {child: i for i, n in enumerate(self.json.get("nodes", ())) for child in n.get("children", ())}
        self._draw_scene()

    @property
    def triangles(self) -> np.ndarray:
        """All triangles, [F, 3, 3]."""
        return np.concatenate([part.corners for part in self.parts]) if self.parts else np.zeros((0, 3, 3))

    # Data: sections 3.6 and 4.4

    def _uri(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        return (self.path.parent / unquote(uri)).read_bytes()

    def _buffer(self, number: int) -> bytes:
        buffer = self.json["buffers"][number]
        return self._uri(buffer["uri"]) if "uri" in buffer else self.binary or b""

    def _view(self, number: int) -> tuple[bytes, int]:
        """Return the bytes of a view and its stride."""
        view = self.json["bufferViews"][number]
        for name in ("EXT_meshopt_compression", "KHR_meshopt_compression"):
            packed = view.get("extensions", {}).get(name)
            if packed:
                import meshopt

                begin = packed.get("byteOffset", 0)
                data = self._buffer(packed["buffer"])[begin : begin + packed["byteLength"]]
                size, count, kind = packed["byteStride"], packed["count"], packed.get("filter", "NONE")
                return meshopt.decode_gltf_buffer(data, count, size, packed["mode"], kind).tobytes(), size
        begin = view.get("byteOffset", 0)
        return self._buffer(view["buffer"])[begin : begin + view["byteLength"]], view.get("byteStride", 0)

    def _items(self, place: dict[str, Any], kind: int, count: int, shape: str) -> np.ndarray:
        data, stride = self._view(place["bufferView"])
        dtype = np.dtype(DTYPES[kind]).newbyteorder("<")
        rows = {"MAT2": 2, "MAT3": 3, "MAT4": 4}.get(shape)
        width = WIDTHS[shape]
        if rows is None:
            offsets = np.arange(width) * dtype.itemsize
            size = width * dtype.itemsize
        else:  # each column starts at a multiple of four bytes
            column = -(-rows * dtype.itemsize // 4) * 4
            offsets = (np.arange(rows)[:, None] * column + np.arange(rows) * dtype.itemsize).reshape(-1)
            size = rows * column
        starts = place.get("byteOffset", 0) + np.arange(count) * (stride or size)
        index = starts[:, None, None] + offsets[None, :, None] + np.arange(dtype.itemsize)
        return np.frombuffer(data, np.uint8)[index].reshape(-1).view(dtype).reshape(count, width)

    def stored(self, number: int) -> np.ndarray:
        """Read an accessor as it is stored, with sparse changes."""
        found = self.json["accessors"][number]
        kind, count, shape = found["componentType"], found["count"], found["type"]
        if count > MOST:
            raise Unsupported(f"{count} elements")
        if "bufferView" in found:
            values = self._items(found, kind, count, shape)
        else:
            values = np.zeros((count, WIDTHS[shape]), DTYPES[kind])
        if "sparse" in found:
            sparse = found["sparse"]
            index = self._items(sparse["indices"], sparse["indices"]["componentType"], sparse["count"], "SCALAR")
            values = values.copy()
            values[index[:, 0].astype(np.int64)] = self._items(sparse["values"], kind, sparse["count"], shape)
        return values

    def numbers(self, number: int, values: np.ndarray | None = None) -> np.ndarray:
        """Read an accessor as float64, integers normalised if it says so."""
        values = self.stored(number) if values is None else values
        if self.json["accessors"][number].get("normalized") and values.dtype.kind in "iu":
            return np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1)
        return values.astype(np.float64)

    # Scenes: section 3.5

    def _draw_scene(self) -> None:
        nodes = self.json.get("nodes", [])
        if self.json.get("scenes"):
            roots = self.json["scenes"][self.json.get("scene", 0)].get("nodes", [])
        else:
            roots = [number for number in range(len(nodes)) if number not in self._parents]
        if not nodes:
            for mesh in self.json.get("meshes", []):
                self._draw_mesh(mesh, {}, [np.eye(4)])
        stack, drawn = list(roots)[::-1], set()
        while stack:
            number = stack.pop()
            if number in drawn:
                continue
            drawn.add(number)
            node = nodes[number]
            if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True):
                continue
            stack += node.get("children", [])[::-1]
            if "mesh" in node:
                frames = [self._world(number) @ copy for copy in self._instances(node)]
                self._draw_mesh(self.json["meshes"][node["mesh"]], node, frames)

    def _world(self, number: int) -> np.ndarray:
        own = _local(self.json["nodes"][number])
        return self._world(self._parents[number]) @ own if number in self._parents else own

    def _instances(self, node: dict[str, Any]) -> list[np.ndarray]:
        found = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        if not found:
            return [np.eye(4)]
        parts = {name.lower(): self.numbers(number) for name, number in found["attributes"].items() if name[0] != "_"}
        count = len(next(iter(parts.values())))
        return [_local({name: values[i] for name, values in parts.items()}) for i in range(count)]

    def _draw_mesh(self, mesh: dict[str, Any], node: dict[str, Any], frames: list[np.ndarray]) -> None:
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode < 4 or "POSITION" not in primitive.get("attributes", {}):
                self.left_out += 1
                continue
            targets = primitive.get("targets", [])
            weights = node.get("weights", mesh.get("weights", [0] * len(targets)))
            faces, values = self._geometry(primitive)

            attribute = partial(self._attribute, primitive, values, weights)
            points = attribute("POSITION")
            assert points is not None
            points = np.pad(points, ((0, 0), (0, 1)), constant_values=1)
            look, slot = self._look(primitive.get("material"))
            uv = attribute(f"TEXCOORD_{slot[0]}") if slot is not None else None
            if uv is not None and slot is not None:
                uv = _transformed(uv, slot[1])
            colors = attribute("COLOR_0")
            if colors is not None:
                colors = np.clip(colors, 0, 1)
                colors = np.pad(colors, ((0, 0), (0, 4 - colors.shape[1])), constant_values=1)
            for frame in frames if "skin" not in node else frames[:1]:
                if "skin" in node:
                    motions = self._skinning(node["skin"], attribute, primitive)
                    moved = np.einsum("vij,vj->vi", motions, points)
                    turned = False
                else:
                    moved = points @ frame.T
                    turned = np.linalg.det(frame[:3, :3]) < 0
                order = faces[:, ::-1] if turned else faces
                self.parts.append(
                    Triangles(
                        moved[order][..., :3],
                        None if uv is None else uv[order],
                        None if colors is None else colors[order],
                        look,
                    )
                )

    def _attribute(
        self, primitive: dict[str, Any], values: dict[str, np.ndarray], weights: list[float], name: str
    ) -> np.ndarray | None:
        """Read an attribute of a primitive, moved by its morph targets."""
        if name not in primitive["attributes"]:
            return None
        result = self.numbers(primitive["attributes"][name], values.get(name))
        targets = primitive.get("targets", [])
        for weight, target in zip(weights if targets else [], targets, strict=True):
            if name in target and weight:
                result = result + weight * self.numbers(target[name])
        return result

    def _geometry(self, primitive: dict[str, Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return faces [F, 3] and the attributes that Draco had: section 3.7.2.1."""
        packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed:
            import DracoPy

            mesh = DracoPy.decode(self._view(packed["bufferView"])[0])
            found = {one["unique_id"]: one["data"] for one in mesh.attributes}
            types = {name: self.json["accessors"][n]["componentType"] for name, n in primitive["attributes"].items()}
            values = {name: found[n].astype(DTYPES[types[name]]) for name, n in packed["attributes"].items()}
            return mesh.faces.astype(np.int64), values
        if "indices" in primitive:
            drawn = self.stored(primitive["indices"])[:, 0].astype(np.int64)
        else:
            drawn = np.arange(self.json["accessors"][primitive["attributes"]["POSITION"]]["count"])
        mode = primitive.get("mode", 4)
        if mode == 4:
            return drawn.reshape(-1, 3), {}
        rows = range(len(drawn) - 2)
        if mode == 5:
            return np.array([drawn[[i, i + 1 + i % 2, i + 2 - i % 2]] for i in rows]).reshape(-1, 3), {}
        return np.array([drawn[[i + 1, i + 2, 0]] for i in rows]).reshape(-1, 3), {}

    def _skinning(self, number: int, attribute: Any, primitive: dict[str, Any]) -> np.ndarray:
        """Return a matrix for each vertex: section 3.7.3."""
        skin = self.json["skins"][number]
        count = len(skin["joints"])
        inverse = np.tile(np.eye(4), (count, 1, 1))
        if "inverseBindMatrices" in skin:
            inverse = self.numbers(skin["inverseBindMatrices"])[:count].reshape(-1, 4, 4).transpose(0, 2, 1)
        frames = np.array([self._world(joint) @ bind for joint, bind in zip(skin["joints"], inverse, strict=True)])
        total: Any = 0
        pull: Any = 0
        for place in range(len(primitive["attributes"])):
            joints, weights = attribute(f"JOINTS_{place}"), attribute(f"WEIGHTS_{place}")
            if joints is None:
                break
            joints = np.where(weights > 0, joints, 0)  # some programs write any number where nothing pulls
            total = total + np.einsum("vk,vkij->vij", weights, frames[joints.astype(np.int64)])
            pull = pull + weights.sum(1)
        return total / pull[:, None, None]

    # Materials: sections 3.9 and 5

    def _look(self, number: int | None) -> tuple[Look, tuple[int, dict[str, Any]] | None]:
        material = {} if number is None else self.json["materials"][number]
        more = material.get("extensions", {})
        old = more.get("KHR_materials_pbrSpecularGlossiness")
        pbr = material.get("pbrMetallicRoughness", {})
        owner, texture, factor = (
            (pbr, "baseColorTexture", "baseColorFactor") if old is None else (old, "diffuseTexture", "diffuseFactor")
        )
        look = Look(np.array(owner.get(factor, [1.0] * 4)), None, (10497, 10497), "KHR_materials_unlit" in more)
        if texture not in owner:
            return look, None
        info = owner[texture]
        entry = self.json["textures"][info["index"]]
        sampler = self.json["samplers"][entry["sampler"]] if "sampler" in entry else {}
        look.wrap = sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)
        look.picture = self._picture(entry)
        change = info.get("extensions", {}).get("KHR_texture_transform", {})
        return look, (change.get("texCoord", info.get("texCoord", 0)), change)

    def _picture(self, texture: dict[str, Any]) -> np.ndarray | None:
        source = texture.get("source")
        for name in ("EXT_texture_webp", "EXT_texture_avif", "KHR_texture_basisu"):
            source = texture.get("extensions", {}).get(name, {}).get("source", source)
        if source is None:
            return None
        if source not in self._pictures:
            image = self.json["images"][source]
            try:
                data = self._view(image["bufferView"])[0] if "bufferView" in image else self._uri(image["uri"])
            except FileNotFoundError:
                self._pictures[source] = None
                return None
            if data[:4] == b"\xabKTX":
                import opengl_basisu

                self._pictures[source] = np.asarray(opengl_basisu.open(data).transcode("rgba8").data)
            else:
                picture = Image.open(io.BytesIO(data))
                if picture.mode.startswith("I"):
                    picture = Image.fromarray((np.asarray(picture, np.float64) / 257).round().astype(np.uint8))
                self._pictures[source] = np.asarray(picture.convert("RGBA"))
        return self._pictures[source]


def _local(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    move, turn, scale = np.eye(4), np.eye(4), np.eye(4)
    move[:3, 3] = node.get("translation", (0, 0, 0))
    vector = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    vector = vector / np.linalg.norm(vector)
    axis, w = vector[:3], vector[3]
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    scale[range(3), range(3)] = node.get("scale", (1, 1, 1))
    return move @ turn @ scale


def _transformed(uv: np.ndarray, change: dict[str, Any]) -> np.ndarray:
    """Apply KHR_texture_transform: translation · rotation · scale, as its text writes the matrices."""
    angle = change.get("rotation", 0.0)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, sine], [-sine, cosine]])
    return (rotation @ (uv * change.get("scale", (1, 1)))[..., None])[..., 0] + change.get("offset", (0, 0))


def to_linear(values: np.ndarray) -> np.ndarray:
    """Convert sRGB to linear light (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def to_display(values: np.ndarray) -> np.ndarray:
    """Convert linear light to sRGB."""
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 1e-12) ** (1 / 2.4) - 0.055)


def _wrapped(index: np.ndarray, size: int, mode: int) -> np.ndarray:
    if mode == 33071:
        return index.clip(0, size - 1)
    if mode == 33648:
        index = index % (2 * size)
        return np.where(index < size, index, 2 * size - 1 - index)
    return index % size


def color_at(part: Triangles, face: np.ndarray, weights: np.ndarray, shrink: int = 1) -> np.ndarray:
    """Evaluate the base colour at barycentric weights [N, 3] of faces [N]: RGBA, sRGB and alpha, [N, 4].

    The picture is averaged over blocks of ``shrink`` pixels before, as mipmaps are.
    """
    result = np.tile(part.look.factor.astype(np.float64), (len(face), 1))
    if part.look.picture is not None and part.uv is not None:
        picture = np.asarray(Image.fromarray(part.look.picture).reduce(shrink)).astype(np.float64) / 255
        uv = (part.uv[face] * weights[..., None]).sum(1)
        height, width = picture.shape[:2]
        x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        along, down = (x - left)[:, None], (y - top)[:, None]
        columns = [_wrapped(left + i, width, part.look.wrap[0]) for i in (0, 1)]
        rows = [_wrapped(top + i, height, part.look.wrap[1]) for i in (0, 1)]
        upper = picture[rows[0], columns[0]] * (1 - along) + picture[rows[0], columns[1]] * along
        lower = picture[rows[1], columns[0]] * (1 - along) + picture[rows[1], columns[1]] * along
        found = upper * (1 - down) + lower * down
        result *= np.concatenate((to_linear(found[:, :3]), found[:, 3:]), 1)
    if part.colors is not None:
        result *= (part.colors[face] * weights[..., None]).sum(1)
    result[:, :3] = to_display(result[:, :3])
    return result
