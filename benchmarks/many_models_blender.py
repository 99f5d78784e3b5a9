"""Views of models by Blender's module bpy, for `many_models.py`: 12 of 512 pixels, with depth and normals."""

from __future__ import annotations

import csv
import math
import sys
import time

import bpy
from mathutils import Vector

table, out, engine = sys.argv[1:4]
with open(table) as file:
    models = list(csv.DictReader(file))


def scene_of(path: str) -> None:
    """Import a model, move it to the origin, and scale its longest side to 2."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.obj_import(filepath=path)
    meshes = [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]
    points = [thing.matrix_world @ Vector(corner) for thing in meshes for corner in thing.bound_box]
    low, high = ([side(point[axis] for point in points) for axis in range(3)] for side in (min, max))
    parent = bpy.data.objects.new("all", None)
    bpy.context.scene.collection.objects.link(parent)
    for thing in meshes:
        thing.parent = parent
    scale = 2 / max(max(b - a for a, b in zip(low, high, strict=True)), 1e-9)
    parent.scale = (scale,) * 3
    parent.location = [-scale * (a + b) / 2 for a, b in zip(low, high, strict=True)]


def prepare() -> tuple[object, object]:
    """Set the engine and the outputs; return the scene and its camera."""
    scene = bpy.context.scene
    scene.render.engine = engine
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.resolution_x = scene.render.resolution_y = 512
    scene.render.film_transparent = True
    if engine == "CYCLES":
        scene.cycles.device, scene.cycles.samples = "CPU", 1
        scene.cycles.use_denoising, scene.cycles.max_bounces = False, 0
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = True
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = math.radians(40)
    scene.collection.objects.link(camera)
    scene.camera = camera
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy = 3.0
    sun.rotation_euler = (0.7, 0.2, 0.5)
    scene.collection.objects.link(sun)
    return scene, camera


start = busy = 0.0
for number, model in enumerate(models):
    if number == 1:
        start, busy = time.monotonic(), time.process_time()  # without the start of the program
    scene_of(model["path"])
    scene, camera = prepare()
    for view in range(12):
        angle = 2 * math.pi * view / 12
        eye = Vector((math.cos(angle) * 3.8, math.sin(angle) * 3.8, 1.4))
        camera.location = eye
        camera.rotation_euler = (-eye).to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = f"{out}/{model['name']}_{view:03d}.png"
        bpy.ops.render.render(write_still=True)
count = len(models) - 1
rate, cost = count / (time.monotonic() - start), (time.process_time() - busy) / (12 * count)
print(f"\nmodels/s {rate:.4f}, {1000 * cost:.0f} ms of processor time a view")
