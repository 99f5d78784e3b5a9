"""Pose and shape of a rig from silhouettes and keypoints, by Gauss-Newton in forward mode."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ... import optim
from ...base import validate
from ...camera import Camera
from ...io.files import as_tensor, existing, read_text, reason, short
from ...meshes.rigs import Pose, Rig
from ...rendering.forward import render
from ..common.geometry.sample_points import sample_points

_LEVELS = 3  # of pyramids of differences between masks
_COARSEST = 48  # least side of the smallest pictures
_SAMPLES = 500  # points on the surface, and pixels of a mask
_REACH = 20.0  # weight of their distances in pixels, for all points of a view together
_TRIALS, _REFINED = 128, 4  # random poses of a limb in a round of the search; best limbs that are fitted
_MOST_VERTICES = 1 << 21  # in poses that are drawn together
_NEAR = 0.7  # half of the trials differ from the current pose by less, in radians
_LEAST_GAIN = 0.02  # of the loss, relative to it, in a round of the search; a smaller one ends it
_WIDEST = 0.1  # motion in a step, relative to the picture's longer side
_CONVERGED = 1e-4  # relative gain of a step below which the fit has converged


class RigFit(NamedTuple):
    """Result of `fit_rig`.

    Attributes:
        pose: The pose, for `Rig.posed`.
        angles: [J, 3] rotation vectors of the joints, in radians; 0 for those that were not fitted.
        shape: [S] shape; without a function `RigShape.weights` the weights of the morph targets.
        translation: [3] translation of the whole.
        loss: Half of the sum of squared residuals at the end.
    """

    pose: Pose
    angles: Tensor
    shape: Tensor
    translation: Tensor
    loss: float


class Priors(NamedTuple):
    """Weights of the priors, relative to a weight of 1 for each pixel; 0 disables a prior.

    Attributes:
        angles: For each radian that a joint, other than roots, is away from rest.
        shape: For each unit that the shape is away from its start.
        smoothness: For each radian that a joint moves from a picture of a sequence to the next.
        keypoints: For each pixel that a keypoint is off.
    """

    angles: float = 0.1
    shape: float = 0.1
    smoothness: float = 1.0
    keypoints: float = 1.0


class RigShape(NamedTuple):
    """A shape to be fitted.

    Attributes:
        start: [S] shape to start with.
        weights: Differentiable function from the shape to weights of morph targets [M]; None: it is these.
        bounds: Least and largest shape, numbers or [S]; or None.
    """

    start: Any
    weights: Callable[[Tensor], Tensor] | None = None
    bounds: tuple[Any, Any] | None = None


def fit_rig(
    rig: Rig,
    camera: Camera,
    masks: Any = None,
    keypoints: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    *,
    size: int | tuple[int, int] | None = None,
    joints: Sequence[str | int] | None = None,
    limits: float | Any = math.pi,
    shape: RigShape | Any = None,
    start: RigFit | None = None,
    priors: Priors | None = None,
    steps: int = 12,
    search: int = 10,
) -> RigFit:
    """Find the joints' rotations, the place and the shape of a rig in one or several views of one moment.

    The start, by default the rig at rest, should overlap its masks, or keypoints should guide it. First keypoints are
    fitted, then masks from small pictures to large ones. A sequence passes each result as the next ``start``; then
    ``priors.smoothness`` holds the joints together.

    Args:
        rig: The rig, on the CPU or a GPU.
        camera: Camera of each view, N of them.
        masks: [N, H, W] floating in [0, 1], silhouettes: shares of the pixels that are covered; or None.
        keypoints: For each view the place of joints in the picture, by their names: x, y in pixels, and a weight ≥ 0;
            or None. See `load_keypoints`.
        size: Height and width of the pictures that keypoints refer to; that of the masks if there are some.
        joints: Names or numbers of the joints to fit; None: all.
        limits: Largest angle of each component in radians, or [J, 2, 3], the least and the largest for each joint.
            Joints without a parent have none, since they turn the whole.
        shape: [S] weights of morph targets to start with, or a `RigShape`; None: the rig's stay as they are.
        start: Result to start with, such as that of the moment before.
        priors: Weights of priors and keypoints.
        steps: Steps of Gauss-Newton at each size, at least 1.
        search: Most rounds of a search for limbs that are lost: each joint is turned at random with all below it. It
            ends with the first round that improves nothing.

    Returns:
        The pose and shape.

    Raises:
        TypeError, ValueError: An argument does not fit; there is neither mask nor keypoint; or a joint is unknown.

    Example:
        >>> vertices, faces = nr.cube()
        >>> rig = nr.Rig(nr.Mesh(vertices, faces), [-1], torch.zeros(1, 3), torch.ones(8, 1))
        >>> camera = nr.Camera.look_at((0.5, 0.7, -4.0))
        >>> goal = rig.pose(translation=torch.tensor([0.2, 0.1, 0.0]))
        >>> found = nr.fit_rig(rig, camera, nr.render(rig.posed(goal), camera, 64).alpha)
        >>> bool((rig.vertices(found.pose) - rig.vertices(goal)).norm(dim=1).mean() < 0.1)
        True
    """
    shape = shape if isinstance(shape, RigShape) else RigShape(torch.zeros(0) if shape is None else shape)
    fit = _Fit(rig, camera, masks, keypoints, size, joints, shape, start, priors or Priors())
    fit.bound(limits)
    return fit.run(validate.whole("steps", steps, 1), validate.whole("search", search, 0))


def load_keypoints(path: str | os.PathLike[str]) -> list[dict[str, list[float]]]:
    """Read keypoints from JSON: a list with an object for each view, from names of joints to [x, y] or [x, y, weight].

    Args:
        path: JSON file.

    Returns:
        Keypoints of each view, as `fit_rig` takes them; x and y are in pixels, from the left upper corner.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: It has another content.

    Example:
        >>> from pathlib import Path
        >>> _ = Path("points.json").write_text('[{"hand_l": [10, 20.5, 1]}]')
        >>> nr.load_keypoints("points.json")
        [{'hand_l': [10.0, 20.5, 1.0]}]
    """
    try:
        views = json.loads(read_text(existing(path)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: expected JSON, got text that is not ({reason(error)})") from error
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise ValueError(f"{path}: expected a list with an object for each view, got {short(views)}")
    return [
        {name: _keypoint(f"{Path(path).name}, view {number}, {short(name)}", value) for name, value in view.items()}
        for number, view in enumerate(views)
    ]


def _keypoint(what: str, value: Any) -> list[float]:
    values = list(value) if isinstance(value, (list, tuple, Tensor)) else []
    try:
        found = [validate.number(what, one) for one in values]
    except TypeError:
        found = []
    if len(found) not in (2, 3) or not all(map(math.isfinite, found)) or (len(found) == 3 and found[2] < 0):
        raise ValueError(f"{what}: expected x, y and a weight from 0 on, got {short(value)}")
    return [*found[:2], found[2] if len(found) == 3 else 1.0]


class _Fit:
    """The parameters of a fit, one vector for each kind, and its residuals."""

    def __init__(
        self,
        rig: Rig,
        camera: Camera,
        masks: Any,
        keypoints: Any,
        size: Any,
        joints: Any,
        shape: RigShape,
        start: RigFit | None,
        priors: Priors,
    ) -> None:
        like = rig.translations
        self._rig, self._camera, self._priors, self._given_shape = rig, camera, priors, shape
        self._masks = None if masks is None else validate.floating("masks", as_tensor(masks), (len(camera), "H", "W"))
        if self._masks is not None:
            validate.finite("masks", self._masks)
            if not bool((self._masks > 0.5).any()):
                raise ValueError("masks: expected the rig in at least one, got empty masks")
            self._masks = self._masks.to(like)
        self._points = self._checked_points(keypoints)
        if self._masks is None and not len(self._points[0]):
            raise ValueError("masks: expected masks or keypoints, got neither")
        if self._masks is None and size is None:
            raise ValueError("size: expected the size of the pictures for keypoints without masks, got None")
        sides = size if self._masks is None else self._masks.shape[-2:]
        self._size: tuple[int, int] = (sides, sides) if isinstance(sides, int) else tuple(sides)
        count = len(rig.parents)
        chosen = range(count) if joints is None else [self._joint("joints", joint) for joint in joints]
        self._joints = torch.tensor(list(chosen), device=like.device, dtype=torch.long)
        self._is_root = torch.tensor([rig.parents[joint] < 0 for joint in chosen], device=like.device)
        self._extent = float((rig.vertices().amax(0) - rig.vertices().amin(0)).max())
        farthest = float(camera.project(rig.vertices(), self._size)[1].abs().max()) + 10 * self._extent
        self._far = 10 * farthest
        before = None if start is None else start.angles[self._joints].to(like)
        self._before = before
        self.angles = torch.zeros(len(self._joints), 3).to(like) if before is None else before.detach().clone()
        self.translation = (
            torch.zeros(3).to(like) if start is None else start.translation.detach().to(like) / self._extent
        )
        first = validate.floating("shape", as_tensor(shape.start), ("S",))
        self._first_shape = first.to(like) if start is None else start.shape.detach().to(like)
        self.shape = self._first_shape.clone()
        self._bounds: Any = {}

    @property
    def _state(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.angles.clone(), self.translation.clone(), self.shape.clone()

    @_state.setter
    def _state(self, state: tuple[Tensor, Tensor, Tensor]) -> None:
        self.angles, self.translation, self.shape = (part.clone() for part in state)

    def bound(self, limits: Any) -> None:
        """Set the limits of joints and shape; roots have none."""
        whole = 4 * math.pi
        if isinstance(limits, (int, float)):
            high = torch.full_like(self.angles, validate.positive("limits", limits))
            low = -high
        else:
            ranges = validate.floating("limits", as_tensor(limits), (len(self._rig.parents), 2, 3))
            low, high = ranges.to(self.angles)[self._joints].unbind(1)
            if not bool((low <= high).all()):
                raise ValueError("limits: expected the least angle before the largest of each joint, got them reversed")
        low[self._is_root], high[self._is_root] = -whole, whole
        self.angles = torch.maximum(torch.minimum(self.angles, high), low)
        self._bounds = {"angles": (low, high), "shape": self._given_shape.bounds}

    def run(self, steps: int, search: int) -> RigFit:
        loss, starts = 0.0, [self._state]
        if len(self._points[0]):
            loss = self._solve(steps, None)
            starts.append(self._state)  # too few keypoints lead away from a start that masks need
        if self._masks is not None:
            sides = [max(self._size)]
            while sides[0] >= 2 * _COARSEST:
                sides.insert(0, sides[0] // 2)
            size = self._sides(sides[0])
            loss = self._search(steps, size, search, self._begin(steps, size, starts))
            for side in sides[1:]:
                loss = self._solve(steps, self._sides(side))
        angles = torch.zeros_like(self._rig.translations).index_copy(0, self._joints, self._state[0])
        with torch.no_grad():
            pose = self._pose(*self._state)
        return RigFit(pose, angles, self.shape, self.translation * self._extent, loss)

    def _begin(self, steps: int, size: tuple[int, int], starts: list[Any]) -> float:
        """Align each start with the masks and fit them; the pose of the last moment is tried as it is, too."""
        found = []
        if self._before is not None:
            found.append((self._solve(steps, size), self._state))
        for start in starts:
            self._state = start
            self._align(steps, size)
            found.append((self._solve(steps, size), self._state))
        loss, self._state = min(found, key=lambda one: one[0])
        return loss

    def _search(self, steps: int, size: tuple[int, int], rounds: int, loss: float) -> float:
        """Rotate limbs at random, and fit again where the loss decreases. End when nothing improves."""
        best = loss, self._state
        low, high = self._bounds["angles"]
        limbs = self._limbs().to(low.device)
        moved = limbs.repeat_interleave(_TRIALS, 0)[..., None]
        generator = torch.Generator().manual_seed(0)
        for _ in range(rounds if len(limbs) else 0):
            self._state = best[1]
            angles = best[1][0]
            share, step = torch.rand(2, len(moved), *low.shape, generator=generator).to(low)
            anywhere, near = low + share * (high - low), angles + _NEAR * (2 * step - 1)
            is_near = torch.arange(len(moved), device=low.device)[:, None, None] % 2 == 0
            trials = torch.where(moved, torch.where(is_near, near, anywhere).clamp(low, high), angles)
            present = float(self._misfits(angles[None], size))
            misfits, places = self._misfits(trials, size).reshape(len(limbs), -1).min(1)
            before = best[0]
            for limb in misfits.argsort()[:_REFINED].tolist():
                if misfits[limb] < present:
                    turned = trials[limb * _TRIALS + int(places[limb])]
                    self._state = (torch.where(limbs[limb, :, None], turned, best[1][0]), *best[1][1:])
                    loss = self._solve(steps, size)
                    if loss < best[0]:
                        best = loss, self._state
            if best[0] > (1 - _LEAST_GAIN) * before:
                break
        self._state = best[1]
        return best[0]

    def _limbs(self) -> Tensor:
        """Return the mask [L, n] of the fitted joints in each limb: a joint that is no root, and its descendants."""
        parents, fitted = self._rig.parents, self._joints.tolist()
        above = []  # ancestors of each joint, with itself
        for joint in fitted:
            line = [joint]
            while line[-1] >= 0:
                line.append(parents[line[-1]])
            above.append(line)
        return torch.tensor([[joint in line for line in above] for joint in fitted if parents[joint] >= 0])

    @torch.no_grad()
    def _misfits(self, angles: Tensor, size: tuple[int, int]) -> Tensor:
        """Compute half of the squared residuals of pictures and keypoints for several poses [B, n, 3]: [B]."""
        goal, views = self._goal(size), len(self._camera)
        found = []
        together = _MOST_VERTICES // (views * len(self._rig.mesh.vertices))
        for part in angles.split(min(max(together, 1), _TRIALS)):
            pose = self._pose(part, *self._state[1:])
            vertices = self._rig.vertices(pose).repeat_interleave(views, 0)
            off = self._drawn(vertices, self._camera[list(range(views)) * len(part)], size) - goal.repeat(
                len(part), 1, 1
            )
            residuals = [level.reshape(len(part), -1) for level in optim.pyramid(off, _LEVELS)]
            if len(self._points[0]):
                residuals.append(self._keypoint_residuals(pose, size).flatten(1))
            found.append(0.5 * torch.cat(residuals, 1).square().sum(1))
        return torch.cat(found)

    def _goal(self, size: tuple[int, int]) -> Tensor:
        return functional.adaptive_avg_pool2d(self._masks[:, None], size)[:, 0]  # type: ignore[index]

    def _drawn(self, vertices: Tensor, camera: Camera, size: tuple[int, int]) -> Tensor:
        mesh, near = (vertices, self._rig.mesh.faces), 1e-4 * self._far
        return render(mesh, camera, size, outputs=("alpha",), near=near, far=self._far).alpha

    def _sides(self, longest: int) -> tuple[int, int]:
        """Return height and width of reduced pictures."""
        height, width = (max(1, side * longest // max(self._size)) for side in self._size)
        return height, width

    def _align(self, steps: int, size: tuple[int, int]) -> None:
        """Minimise distances of surface points to masks and of mask pixels to the surface; has a larger basin."""
        goals = self._goal(size)
        pixels = torch.stack(torch.meshgrid(*(torch.arange(n) + 0.5 for n in size[::-1]), indexing="xy"), -1).to(goals)
        faces = self._rig.mesh.faces.long()
        generator = torch.Generator(faces.device).manual_seed(0)
        on = sample_points((self._rig.vertices().detach(), faces), _SAMPLES, generator)
        inner = {view: inside for view, goal in enumerate(goals) if len(inside := pixels[goal > 0.5])}

        def residuals(pose: Pose) -> list[Tensor]:
            corners = self._rig.vertices(pose)[faces[on.face_index]]
            places = self._camera.project((on.weights[..., None] * corners).sum(1), size)[0]
            found = []
            for view, inside in inner.items():
                points, chosen = places[view], inside[:: max(1, len(inside) // _SAMPLES)]
                fixed = points.detach()
                beyond = points - inside[torch.cdist(fixed, inside).argmin(1)]
                beyond = beyond * (beyond.detach().abs().amax(1, keepdim=True) > 0.5)
                missing = points[torch.cdist(chosen, fixed).argmin(1)] - chosen
                found += [beyond * _REACH / math.sqrt(len(points)), missing * _REACH / math.sqrt(len(chosen))]
            return found

        self._solve(steps, size, residuals)

    def _solve(
        self, steps: int, size: tuple[int, int] | None, compare: Callable[[Pose], list[Tensor]] | None = None
    ) -> float:
        parameters = [self.angles, self.translation] + ([self.shape] if len(self.shape) else [])
        groups: list[dict[str, Any]] = [{"params": [self.angles], "bounds": self._bounds["angles"]}]
        groups.append({"params": [self.translation]})
        if len(self.shape):
            groups.append({"params": [self.shape], "bounds": self._bounds["shape"]})
        columns = sum(one.numel() for one in parameters)
        goal = None if size is None or self._masks is None else self._goal(size)

        def positions(angles: Tensor, translation: Tensor, shape: Tensor = self.shape) -> Tensor:
            joints = self._rig.joints(self._pose(angles, translation, shape))
            return self._camera.project(joints, size or self._size)[0]

        def residuals(angles: Tensor, translation: Tensor, shape: Tensor = self.shape) -> list[Tensor]:
            pose = self._pose(angles, translation, shape)
            found = self._prior_residuals(angles, shape)
            if len(self._points[0]):
                found.append(self._keypoint_residuals(pose, size))
            if compare is not None:
                found += compare(pose)
            elif goal is not None and size is not None:
                found += optim.pyramid(self._drawn(self._rig.vertices(pose), self._camera, size) - goal, _LEVELS)
            return found

        reach = _WIDEST * max(size or self._size)
        optimizer = optim.GaussNewton(groups, positions=positions, pixels=reach, most_columns=columns)
        loss = math.inf
        for _ in range(steps):
            before, loss = loss, float(optimizer.step(residuals))
            if before - loss < _CONVERGED * loss:
                break
        return loss

    def _pose(self, angles: Tensor, translation: Tensor, shape: Tensor) -> Pose:
        everything = (
            torch.zeros(*angles.shape[:-2], *self._rig.translations.shape)
            .to(angles)
            .index_copy(-2, self._joints, angles)
        )
        weights = None
        if len(shape):
            weights = shape if self._given_shape.weights is None else self._given_shape.weights(shape)
        return self._rig.pose(everything, weights, translation=translation * self._extent)

    def _prior_residuals(self, angles: Tensor, shape: Tensor) -> list[Tensor]:
        priors = self._priors
        found = [priors.angles * angles[~self._is_root]]
        if len(shape):
            found.append(priors.shape * (shape - self._first_shape))
        if self._before is not None:
            found.append(priors.smoothness * (angles - self._before))
        return found

    def _keypoint_residuals(self, pose: Pose, size: tuple[int, int] | None) -> Tensor:
        """Compare joints with keypoints, in pixels of pictures of this size."""
        views, joints, points, weights = self._points
        positions = self._rig.joints(pose)
        positions = positions.reshape(-1, *positions.shape[-2:])
        places = torch.stack([camera.project(positions, self._size)[0] for camera in self._camera], 1)[:, views, joints]
        scale = max(size or self._size) / max(self._size)
        return self._priors.keypoints * scale * weights[:, None] * (places - points)

    def _checked_points(self, keypoints: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Collect keypoints: view, joint, place [P, 2] and weight of each."""
        views = [keypoints] if isinstance(keypoints, Mapping) else list(keypoints or ())
        if views and len(views) != len(self._camera):
            raise ValueError(f"keypoints: expected those of {len(self._camera)} views, got {len(views)}")
        rows = []
        for view, points in enumerate(views):
            for name, value in points.items():
                what = f"keypoints of view {view}"
                rows.append((view, self._joint(what, name), *_keypoint(f"{what}, {short(name)}", value)))
        table = torch.tensor(rows, dtype=torch.float64).reshape(-1, 5).to(self._rig.translations.device)
        values = table.to(self._rig.translations)
        return table[:, 0].long(), table[:, 1].long(), values[:, 2:4], values[:, 4]

    def _joint(self, what: str, joint: Any) -> int:
        """Return the number of a joint."""
        names = self._rig.names
        if isinstance(joint, str) and joint in names:
            return names.index(joint)
        if isinstance(joint, int) and not isinstance(joint, bool) and 0 <= joint < len(names):
            return joint
        raise ValueError(f"{what}: expected a joint of the rig, such as {short(names[0])}, got {short(joint)}")
