"""Grammars of displays, lamps, rifles and blasters, built from parts.

Lengths are relative; a shape is scaled to a longest side of 1 afterwards. The front of an object is at +z.
"""

from __future__ import annotations

import numpy as np

from .parts import Builder


def display(b: Builder) -> None:
    """Build a monitor, a television or a laptop."""
    width = b.uniform(0.7, 1.3)
    height, frame = width * b.uniform(0.5, 0.85), b.color()
    screen = b.rng.uniform(0, 0.3, 3) if b.chance(0.7) else b.color()
    deep = b.uniform(0.02, 0.12) if b.chance(0.65) else b.uniform(0.2, 0.7)
    neck = b.uniform(0.03, 0.3)
    since = len(b.parts)
    b.box((0, neck + height / 2, 0), (width, height, min(deep, 0.25)), frame, bevel=0.15 * b.chance(0.4))
    b.box((0, neck + height / 2, min(deep, 0.25) / 2), (width * 0.9, height * 0.85, 0.015), screen)
    if deep > 0.15:
        plan = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)])
        rings = []
        for z, s in ((0.0, 0.95), (-deep, b.uniform(0.5, 0.9))):
            x, y = (plan * (width, height) * s / 2).T
            rings.append(np.stack((x, neck + height / 2 + y, np.full(4, z)), -1))
        b.loft(np.stack(rings), frame)
    b.lean(since, -b.uniform(0, 10) * b.chance(0.4), (neck, 0))
    kind = b.rng.integers(4)
    back = -deep * 0.3
    if kind == 0:
        for s in (1, -1):
            b.rod((s * width * 0.35, 0, 0.12), (s * width * 0.3, neck + 0.02, back), 0.02, frame)
            b.rod((s * width * 0.35, 0, -0.15 + back), (s * width * 0.3, neck + 0.02, back), 0.02, frame)
    elif kind == 1:
        b.turned((0, 0, back), [(width * 0.22, 0), (width * 0.2, 0.03)], frame)
        b.rod((0, 0, back), (0, neck + height * 0.2, back), 0.035, frame)
    elif kind == 2:
        b.box((0, 0.015, back), (width * b.uniform(0.3, 0.6), 0.03, b.uniform(0.2, 0.35)), frame)
        b.box((0, neck / 2 + 0.05, back), (width * b.uniform(0.08, 0.3), neck + 0.1, 0.04), frame)
    else:
        b.box((0, neck / 2, back), (width * 0.8, neck, max(deep, 0.2)), frame)
    if b.chance(0.1):
        for s in (1, -1):
            b.rod((0, neck + height, back), (s * width * 0.3, neck + height * 1.6, back), 0.012, frame)


def lamp(b: Builder) -> None:
    """Build a table, floor, ceiling or street lamp."""
    metal, shade = b.color(), np.clip(b.uniform(0.6, 1) + b.rng.uniform(-0.2, 0.1, 3), 0, 1)
    kind, pole = b.rng.choice(5, p=[0.3, 0.22, 0.22, 0.16, 0.1]), b.uniform(0.012, 0.03)
    wide = b.uniform(0.12, 0.3)
    top = wide * b.uniform(0.4, 1)
    square = 4 if b.chance(0.25) else 16

    def hood(center: tuple[float, float, float], scale: float = 1.0) -> None:
        high = scale * b.uniform(0.15, 0.45)
        if b.chance(0.3):
            r = scale * wide * 0.8
            angles = np.linspace(0, np.pi, 8)
            b.turned(center, [(r * np.sin(a) + 1e-3, r * (1 - np.cos(a))) for a in angles], shade)
        else:
            b.turned(center, [(scale * wide, 0), (scale * top, high)], shade, square)
            if b.chance(0.4):  # open below
                low = center[0], center[1] - 0.01, center[2]
                b.turned(low, [(scale * wide * 0.85, 0), (scale * top * 0.8, high * 0.85)], shade, square)
                b.cut(len(b.parts) - 2)

    if kind == 0:
        high, r = b.uniform(0.25, 0.6), b.uniform(0.08, 0.16)
        profile = [(r, 0), (r, 0.02)]
        if b.chance(0.5):
            profile += [(r * b.uniform(0.3, 1.2), y * high) for y in (0.15, 0.35, 0.55, 0.75)]
        b.turned((0, 0, 0), [*profile, (pole, high)], metal)
        b.rod((0, 0, 0), (0, high + 0.1, 0), pole, metal)
        hood((0, high, 0))
    elif kind == 1:
        high, r = b.uniform(1.0, 1.7), b.uniform(0.12, 0.22)
        b.turned((0, 0, 0), [(r, 0), (r, 0.03)], metal, square)
        b.rod((0, 0, 0), (0, high, 0), pole, metal)
        hood((0, high - 0.1, 0), 1.2)
    elif kind == 2:
        high = b.uniform(0.1, 0.7)
        b.turned((0, high + 0.3, 0), [(0.08, 0), (0.08, 0.03)], metal)
        b.rod((0, 0.1, 0), (0, high + 0.3, 0), pole * 0.7, metal)
        if b.chance(0.4):
            arms = int(b.rng.integers(3, 7))
            for angle in 2 * np.pi * np.arange(arms) / arms:
                end = np.array([np.cos(angle), 0, np.sin(angle)]) * b.uniform(0.3, 0.4)
                b.rod((0, 0.15, 0), end + [0, 0.15, 0], pole, metal)
                hood((end[0], 0.1, end[2]), 0.4)
        else:
            hood((0, -0.1, 0), 1.2)
    elif kind == 3:
        high, reach, arms = b.uniform(1.2, 2.2), b.uniform(0.25, 0.6), int(b.rng.integers(1, 3))
        b.turned((0, 0, 0), [(0.09, 0), (0.07, 0.1)], metal)
        b.rod((0, 0, 0), (0, high, 0), pole * 1.3, metal, 0.8)
        since = len(b.parts)
        b.rod((0, high, 0), (reach, high + b.uniform(-0.05, 0.1), 0), pole, metal)
        b.box((reach, high, 0), (0.25, 0.06, 0.12), shade)
        if arms == 2:
            b.twin(since)
    else:
        reach, r = b.uniform(0.2, 0.5), 0.12
        b.turned((0, 0, 0), [(r, 0), (r, 0.03)], metal)
        b.rod((0, 0, 0), (-reach * 0.5, reach, 0), pole, metal)
        b.rod((-reach * 0.5, reach, 0), (reach * 0.7, reach * 1.6, 0), pole, metal)
        b.turned((reach * 0.7, reach * 1.45, 0), [(0.14, 0), (0.05, 0.15)], shade)


def gun(b: Builder, toy: bool) -> None:
    """Build a rifle or, as a ``toy``, a short blaster; the muzzle is at −z, of some rifles at +z."""
    body, grip = b.color(), b.color()
    if not toy and b.chance(0.7):
        body = b.uniform(0.05, 0.35) + np.zeros(3)
    thick = b.uniform(0.05, 0.1) if not toy else b.uniform(0.1, 0.22)
    long, high = (
        (b.uniform(0.35, 0.7), b.uniform(0.1, 0.18)) if not toy else (b.uniform(0.4, 0.8), b.uniform(0.2, 0.36))
    )
    b.box((0, 0, 0), (thick, high, long), body, b.uniform(0.8, 1), bevel=0.2 * b.chance(0.4))
    barrel, r = (
        (b.uniform(0.3, 0.9), b.uniform(0.015, 0.035)) if not toy else (b.uniform(0.1, 0.45), b.uniform(0.04, 0.11))
    )
    y, z = high * b.uniform(0.0, 0.3), long / 2
    b.rod((0, y, z - 0.02), (0, y, z + barrel), r, grip if b.chance(0.5) else body)
    if b.chance(0.5):
        tip = b.uniform(0.1, 0.4) * barrel
        b.rod((0, y, z + barrel - tip), (0, y, z + barrel + 0.03), r * b.uniform(1.3, 2), grip)
    if b.chance(0.7):
        guard = barrel * b.uniform(0.4, 0.8)
        b.box((0, y - r * 0.5, z + guard / 2), (thick * 0.9, high * b.uniform(0.4, 0.8), guard), grip)
    place, size = -long * b.uniform(0.2, 0.45), high * b.uniform(0.9, 1.6)
    handle = np.array([[0.0, 0.0], [0.12, 0.0], [0.07, -size], [-0.07, -size]]) * [b.uniform(0.7, 1.4), 1] + [
        place,
        -high * 0.4,
    ]
    b.plate(handle, -thick * 0.4, thick * 0.4, grip)
    if b.chance(0.4):  # the trigger's guard
        ring = np.array([[0.2, 0.0], [0.2, -0.1], [0.02, -0.1], [0.02, 0.0]]) + [place, -high * 0.45]
        b.plate(ring, -thick * 0.2, thick * 0.2, grip)
        b.plate((ring - ring.mean(0)) * 0.7 + ring.mean(0), -thick, thick, grip)
        b.cut(len(b.parts) - 2)
    if b.chance(0.65):
        down, tilt = b.uniform(0.12, 0.4), b.uniform(-0.05, 0.12)
        mag = np.array([[0.0, 0.0], [0.1, 0], [0.1 + tilt, -down], [tilt, -down]]) + [
            long * b.uniform(-0.05, 0.3),
            -high * 0.4,
        ]
        b.plate(mag, -thick * 0.3, thick * 0.3, body)
    if not toy or b.chance(0.3):
        back, drop = b.uniform(0.35, 0.6), b.uniform(0.02, 0.15)
        stock = np.array(
            [[0.02, high * 0.4], [0.02, -high * 0.3], [-back, -high * 0.5 - drop], [-back, high * 0.3 - drop * 0.3]]
        )
        b.plate(stock + [-long / 2, 0.0], -thick * 0.35, thick * 0.35, grip)
    if b.chance(0.5):
        s, up = b.uniform(0.15, 0.35), high / 2 + b.uniform(0.03, 0.07)
        b.rod((0, up, -s / 2), (0, up, s / 2), b.uniform(0.02, 0.045) * (1.5 if toy else 1), grip)
        b.box((0, high / 2 + 0.01, 0), (thick * 0.4, 0.08, s * 0.5), body)
    for _ in range(int(b.rng.integers(0, 4)) if toy else 0):
        b.box(
            (0, b.uniform(-0.6, 0.7) * high, b.uniform(-0.5, 0.8) * long),
            (thick * b.uniform(0.7, 1.3), high * b.uniform(0.2, 0.6), long * b.uniform(0.1, 0.4)),
            b.color(),
        )
    if toy or b.chance(0.7):
        b.turn()
