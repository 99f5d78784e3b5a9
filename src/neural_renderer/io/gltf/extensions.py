"""Extensions of glTF: which are read, and what is lost with those that are not."""

from __future__ import annotations

from typing import Any

from ..files import short
from .tree import GltfError, texts

READ = frozenset(
    (
        "EXT_mesh_gpu_instancing",
        "EXT_meshopt_compression",
        "EXT_texture_avif",
        "EXT_texture_webp",
        "KHR_draco_mesh_compression",
        "KHR_materials_emissive_strength",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_unlit",
        "KHR_materials_variants",
        "KHR_mesh_quantization",
        "KHR_meshopt_compression",
        "KHR_node_visibility",
        "KHR_texture_basisu",
        "KHR_texture_transform",
    )
)

_INVISIBLE = frozenset(
    (
        "EXT_instance_features",
        "EXT_mesh_features",
        "EXT_mesh_manifold",
        "EXT_structural_metadata",
        "FB_ngon_encoding",
        "KHR_xmp",
        "KHR_xmp_json_ld",
        "MSFT_lod",
    )
)
"""Those that change no picture."""

_EFFECTS = {
    "EXT_lights_ies": "lamps",
    "EXT_lights_image_based": "an environment",
    "KHR_animation_pointer": "animations of other properties",
    "KHR_audio_emitter": "sound",
    "KHR_gaussian_splatting": "splats, drawn as points",
    "KHR_lights_punctual": "lamps",
    "KHR_materials_anisotropy": "stretched highlights",
    "KHR_materials_clearcoat": "a clear coat on materials",
    "KHR_materials_diffuse_transmission": "light through thin materials",
    "KHR_materials_dispersion": "colours of refracted light",
    "KHR_materials_ior": "the strength of reflections",
    "KHR_materials_iridescence": "colours of thin films",
    "KHR_materials_sheen": "the sheen of cloth",
    "KHR_materials_specular": "the strength and colour of reflections",
    "KHR_materials_subsurface": "light below surfaces",
    "KHR_materials_transmission": "transparency of glass",
    "KHR_materials_volume": "absorption in glass",
    "KHR_techniques_webgl": "shaders",
    "MSFT_lod": "coarser versions of meshes",
    "MSFT_texture_dds": "pictures in DDS",
}
"""What others change."""


def checked_extensions(tree: dict[str, Any]) -> str | None:
    """Raise GltfError if a file requires an extension that is not read; return a sentence on those that it uses."""
    required = [name for name in texts(tree, "extensionsRequired") if name not in READ]
    if required:
        raise GltfError(
            f"it requires the extension {', '.join(map(_named, dict.fromkeys(required)))}, which is not read; a file "
            "that has it in extensionsUsed alone is read without it"
        )
    used = [name for name in dict.fromkeys(texts(tree, "extensionsUsed")) if name not in READ | _INVISIBLE]
    if not used:
        return None
    return f"it uses {', '.join(map(_named, used))}, which is left out"


def _named(name: str) -> str:
    return f"{short(name)[1:-1]} ({_EFFECTS.get(name, 'of unknown effect')})"
