"""The lit colour of each pixel, from the cube of texels or the corner colours of its face."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Optional

from torch import Tensor

from ..ops.barycentrics import motion_of
from ..ops.visible_faces import scene_of, visible_faces
from ..warp import registration
from ..warp.elementwise import in_pieces
from ..warp.launch import launch, launch_pixels
from ..warp.layout import face_tasks, in_any_order, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.native import BACKWARD, Call, Kernels
from .composite import background_of, behind_faces, grad_of

# No fused multiply-adds, as in `barycentrics`, so that the weights are bitwise equal.
_KERNELS = Kernels(__name__, "texture_cubes.h", fused=False)
_LitCubes, _LightCorners, _SampleCubes = map(_KERNELS.struct, ("LitCubes", "LightCorners", "SampleCubes"))
_Scene = _KERNELS.struct("Scene")
_BACKWARD = Kernels(__name__ + BACKWARD, "texture_cubes.h", fused=False)
_SampleCubesBackward = _BACKWARD.struct("SampleCubesBackward")
_FORWARD = Kernels(__name__ + ".forward", "texture_cubes.h", fused=False)
_SampleCubesForward = _FORWARD.struct("SampleCubesForward")
_light_corners = _KERNELS.kernel("light_corners", _LightCorners)
_sample_pixels = _KERNELS.kernel("sample_pixels", _SampleCubes)
_cubes_of_face_backward = _BACKWARD.kernel("cubes_of_face_backward", _SampleCubesBackward)
_cubes_of_run_backward = _BACKWARD.kernel("cubes_of_run_backward", _SampleCubesBackward, only_cuda=True)
_sample_pixels_forward = _FORWARD.kernel("sample_pixels_forward", _SampleCubesForward)
_MANY_FACES = 1 << 12  # that justify another CPU thread


@registration.operator
def sample_textures(
    textures: Tensor,
    light: Tensor,
    background: Tensor,
    faces: Tensor,
    face_index: Tensor,
    eps: float,
    perspective: bool,
    firsts: Tensor | None = None,
    below: int = 0,
    above: int = 0,
) -> Tensor:
    """Sample colours of faces, [B, 3, H, W] float32; differentiable in textures, light, background and faces.

    In a cube, the coordinate along the axis of corner k is T - 1 times its weight; the 8 texels around it are blended.
    With T = 1 a face has one colour. Colours of corners are blended by the weights. The gradient to faces comes from
    the colours inside them, through the weights.

    Args:
        textures: Cubes, [B or 1, F, T, T, T, 3] float32; texel [a][b][c] belongs to corner weights (0, 1, 2). Or
            colours of the corners, [B or 1, F, 3, 3] float32.
        light: Factors on the front and the back of each face, [B or 1, 2, F, 3] float32. On the front, corners run
            counter-clockwise.
        background: [B, 3, H, W] float32, for pixels without a face.
        faces, face_index, perspective, below, above: As in `barycentrics`.
        eps: Cube coordinates end at T - 1 - eps.
        firsts: For images with different numbers of faces, whose textures are concatenated to [1, N, ...]: index of the
            first face of each, and N, [B + 1] int32. Faces and light are then padded.
    """
    batch, height, width = face_index.shape
    color = empty((batch, 3, height, width), faces.device)
    fields = _fields(textures, light, faces, face_index, eps, perspective, firsts, below, above)
    fields |= {"background": background_of(background), "color": color}
    launch_pixels(_sample_pixels, _SampleCubes, batch * height, width, faces.device, **fields)
    return color


@registration.fake(sample_textures)
def _(faces: Tensor, face_index: Tensor) -> Tensor:
    batch, height, width = face_index.shape
    return faces.new_empty((batch, 3, height, width))


@registration.gradient_of(sample_textures, "textures", "light", "faces", leave_out="background")
def sample_textures_backward(
    grad: Tensor, textures_too: bool, light_too: bool, faces_too: bool, *inputs: Any
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients of `sample_textures` to textures, light and faces; empty if not needed.

    ``grad`` as for `grad_of`.
    """
    textures, light, faces, face_index, _, _, firsts, *_ = inputs
    batch, height, width = face_index.shape
    concurrently = in_any_order(faces.device)
    # The task of a face clears its own cubes, which saves a pass over the memory.
    to_textures = empty(registration.gradient_shape(textures, textures_too), faces.device)
    if concurrently or batch == 0:
        to_textures.zero_()
    to_light = zeros((batch, *light.shape[1:]) if light_too else (0,) * 4, faces.device)
    to_faces = zeros(registration.gradient_shape(faces, faces_too), faces.device)
    fields = _fields(*inputs) | {
        "grad": grad_of(grad, face_index),
        "textures_too": textures_too,
        "light_too": light_too,
        "faces_too": faces_too,
        "to_textures": to_textures,
        "to_light": to_light,
        "to_faces": to_faces,
    }
    if concurrently:
        tasks, run = run_tasks(batch * height, width)
        launch(_cubes_of_run_backward, tasks, [_SampleCubesBackward(run=run, **fields)], faces.device)
    else:
        # One task sums the gradient to shared textures, image by image.
        owners = len(textures) if firsts is None else batch
        tasks, least = min(owners, batch) * faces.shape[1], face_tasks(faces, height * width)
        call = _SampleCubesBackward(visible=visible_faces(face_index, faces.shape[1]), **fields)
        launch(_cubes_of_face_backward, tasks, [call], faces.device, least)
    if light.shape[0] < len(to_light):
        to_light = in_pieces(lambda part: part.sum(0, keepdim=True), to_light, dim=2)
    return to_textures, to_light, to_faces


@registration.forward_operator(2, sample_textures, leave_out="background")
def sample_textures_forward(
    to_light: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    motion: Tensor,
    *inputs: Any,
) -> Tensor:
    """Compute the tangent [T, B, 3, H, W] of `sample_textures` for tangents of the corners, [T, B, F, 3, 3] float32.

    ``to_light`` is a tangent of the light, [T, B or 1, 2, F, 3] float32, or None.
    """
    batch, height, width = inputs[3].shape
    change = empty((len(motion), batch, 3, height, width), motion.device)
    tasks, moved = motion_of(motion, inputs[3])
    call = _SampleCubesForward(**_fields(*inputs), motion=moved, to_light=to_light, change=change)
    launch(_sample_pixels_forward, tasks, [call], motion.device, worth_a_thread(moved.each * width * len(motion)))
    return change


def _fields(textures: Tensor, light: Tensor, *scene: Any) -> dict[str, Any]:
    """List the fields of kernels from the inputs of `sample_textures`, without the background."""
    faces, face_index, eps, perspective, firsts, below, above = scene
    cubes = lit_cubes(textures, light, eps, firsts)
    return {"scene": scene_of(faces, face_index, perspective, below, above), "textures": cubes}


@registration.operator
def lit_corners(textures: Tensor, light: Tensor, faces: Tensor, perspective: bool, firsts: Tensor | None) -> Tensor:
    """Light the colours of corners, or cubes of one texel, on the visible sides of faces: [B, F, 3, 3] float32.

    Arguments as of `sample_textures`. Padding is black. The result has no gradient.
    """
    lit = empty(faces.shape, faces.device)
    batch, count = faces.shape[:2]
    scene = _Scene(faces=faces, count=count, perspective=perspective)
    call = _LightCorners(scene=scene, textures=lit_cubes(textures, light, firsts=firsts), lit=lit)
    launch(_light_corners, batch * count, [call], faces.device, _MANY_FACES)
    return lit


@registration.fake(lit_corners)
def _(faces: Tensor) -> Tensor:
    return faces.new_empty(faces.shape)


def lit_cubes(textures: Tensor, light: Tensor, eps: float = 0.0, firsts: Tensor | None = None) -> Call:
    """Make the `LitCubes` of kernels; arguments as of `sample_textures`."""
    return _LitCubes(
        texels=textures,
        firsts=firsts,
        light=light,
        cubes=textures.shape[0] if firsts is None else len(firsts) - 1,
        lamps=light.shape[0],
        size=textures.shape[2] if textures.dim() == 6 else 0,
        eps=eps,
    )


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    textures, light, _, *scene = inputs
    registration.save_inputs(ctx, (textures, light, *scene), output)


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    inputs = textures, _, faces, face_index, *_ = registration.saved_inputs(ctx)
    asked, found = [ctx.needs_input_grad[k] for k in (0, 1, 3)], {}
    if ctx.needs_input_grad[2]:
        found["background"] = behind_faces(grad, face_index)
    if asked[2] and textures.dim() == 6 and textures.shape[2] == 1:  # a face of one colour has no slope
        asked[2], found["faces"] = False, faces.new_zeros(()).expand(faces.shape)
    if any(asked):
        results = zip(("textures", "light", "faces"), sample_textures_backward(grad, *asked, *inputs), strict=True)
        found |= {name: to for (name, to), too in zip(results, asked, strict=True) if too}
    return found


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    textures, light, background, *options = inputs
    face_index = options[1]
    to_textures, to_light, to_background, motion = tangents[:4]
    black = background.new_zeros(()).expand(background.shape)
    parts = []
    if to_textures is not None:
        parts.append(sample_textures(to_textures, light, black, *options))
    if to_light is not None and motion is None:
        parts.append(sample_textures(textures, to_light, black, *options))
    if to_background is not None:
        parts.append(behind_faces(to_background, face_index))
    if motion is not None:
        parts.append(registration.in_direction(sample_textures_forward, (to_light, motion), textures, light, *options))
    return registration.sum_of(parts)


registration.differentiable(sample_textures, _to_inputs, _save, _forward)


def _to_first(ctx: Any, textures: Tensor, light: Tensor, _: Tensor) -> Any:
    """Differentiate <textures, their gradient> + <light, its gradient>; colours are linear in textures and in light."""
    grad, textures_too, light_too, _, own_textures, own_light, *scene = registration.saved_inputs(ctx)
    if ctx.needs_input_grad[6]:
        registration.refuse_second("sample_textures_backward")
    black = grad.new_zeros(()).expand(grad.shape)
    found: dict[str, Any] = {"grad": None}
    if textures_too:
        found["grad"] = sample_textures(textures, own_light, black, *scene)
        if ctx.needs_input_grad[5]:
            found["light"] = sample_textures_backward(grad, False, True, False, textures, own_light, *scene)[1]
    if light_too:
        more = sample_textures(own_textures, light, black, *scene)
        found["grad"] = more if found["grad"] is None else found["grad"] + more
        if ctx.needs_input_grad[4]:
            found["textures"] = sample_textures_backward(grad, True, False, False, own_textures, light, *scene)[0]
    return found


registration.differentiable(sample_textures_backward, _to_first, registration.save_inputs)


@dataclass(frozen=True, eq=False)
class CornerColors:
    """Colours of corners [1 or B, F, 3, 3], or cubes of one texel, under light [1 or B, 2, F, 3], if there is light.

    The gradient through visibility reads them where faces interpolate colours.

    ``firsts`` as in `sample_textures`; then there is light, too.
    """

    colors: Tensor
    light: Tensor | None
    firsts: Tensor | None = None

    def __call__(self, corners: Tensor, perspective: bool) -> Tensor:
        """Light the colours on the visible sides of faces with screen-space corners [B, F, 3, 3]: [1 or B, F, 3, 3]."""
        colors = self.colors.detach().float()
        if self.light is None:
            return colors if colors.dim() == 4 else colors[:, :, 0, 0].expand(-1, -1, 3, -1)
        return lit_corners(colors.contiguous(), self.light.detach(), corners.contiguous(), perspective, self.firsts)
