"""Grammars of the 13 categories of the free models: each builds a random object of a category from parts.

Lengths are relative; a shape is scaled to a longest side of 1 afterwards. The front of an object is at +z.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .parts import Array, Builder


def _legs(b: Builder, width: float, depth: float, top: float, color: Array) -> None:
    """Add four legs, a pedestal, a sled or two side panels under a rectangle at height ``top``."""
    kind = b.rng.choice(5, p=[0.5, 0.15, 0.12, 0.13, 0.1])
    radius, splay = b.uniform(0.015, 0.05), b.uniform(0, 0.1) * b.chance(0.4)
    x, z = width / 2 - radius * b.uniform(1, 2.5), depth / 2 - radius * b.uniform(1, 2.5)
    if kind == 0:
        square = b.chance(0.55)
        for sx, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            foot = (sx * (x + splay), 0, sz * (z + splay))
            b.rod(foot, (sx * x, top, sz * z), radius, color, b.uniform(1, 1.5), 4 if square else 10)
        if b.chance(0.3):
            height = b.uniform(0.15, 0.6) * top
            for s in (1, -1):
                b.rod((s * x, height, z), (s * x, height, -z), radius * 0.7, color)
            b.rod((x, height, 0), (-x, height, 0), radius * 0.7, color)
    elif kind == 1:
        base = b.uniform(0.25, 0.45) * min(width, depth)
        b.turned((0, 0, 0), [(base, 0), (base, 0.03), (radius * 1.4, 0.06), (radius * 1.2, top)], color)
    elif kind == 2:
        for s in (1, -1):
            b.rod((s * x, radius, z), (s * x, radius, -z), radius, color)
            for sz in (1, -1):
                b.rod((s * x, radius, sz * z), (s * x, top, sz * z), radius, color)
    elif kind == 3:
        for s in (1, -1):
            b.box((s * x, top / 2, 0), (2 * radius, top, depth * b.uniform(0.7, 1)), color)
    else:
        arms = int(b.rng.integers(3, 6))
        b.rod((0, 0.06, 0), (0, top, 0), radius * 1.3, color)
        for angle in 2 * np.pi * np.arange(arms) / arms:
            end = 0.45 * min(width, depth) * np.array([np.cos(angle), 0, np.sin(angle)])
            b.rod((0, 0.08, 0), end + [0, radius, 0], radius, color)


def _chair(b: Builder) -> None:
    """Build a chair, an office chair or a stool."""
    width, depth = b.uniform(0.4, 0.6), b.uniform(0.4, 0.6)
    seat, thick = b.uniform(0.35, 0.55), b.uniform(0.03, 0.12)
    frame, cloth = b.color(), b.color()
    stool = b.chance(0.2)
    if stool:
        seat = b.uniform(0.3, 0.9)
    _legs(b, width, depth, seat, frame)
    if b.chance(0.25):
        b.turned((0, seat, 0), [(width / 2, 0), (width / 2, thick)], cloth, 18)
    elif b.chance(0.5):
        b.cushion((0, seat + thick / 2, 0), (width, thick, depth), cloth)
    else:
        b.box((0, seat + thick / 2, 0), (width, thick, depth), cloth, bevel=0.3 * b.chance(0.5))
    if stool:
        return
    since, high, deep = len(b.parts), b.uniform(0.35, 0.65), b.uniform(0.03, 0.09)
    back, floor = -depth / 2 + deep / 2, seat + thick
    kind = b.rng.integers(4)
    if kind == 0:
        b.box((0, floor + high / 2, back), (width, high, deep), cloth, b.uniform(0.8, 1))
    elif kind == 1:
        b.cushion((0, floor + high * 0.6, back), (width * b.uniform(0.8, 1), high * 0.8, deep * 1.5), cloth)
        b.rod((0, seat, back), (0, floor + high * 0.6, back), 0.03, frame)
    else:
        for s in (1, -1):
            b.box((s * (width / 2 - 0.025), floor + high / 2, back), (0.05, high, 0.05), frame)
        count = int(b.rng.integers(1, 5))
        if kind == 2:
            for y in floor + high * (np.arange(count) + 1.0) / count - 0.05:
                b.box((0, y, back), (width, b.uniform(0.5, 0.8) * high / (count + 1), 0.03), frame)
        else:
            b.box((0, floor + high - 0.04, back), (width, 0.08, 0.04), frame)
            for x in np.linspace(-0.3, 0.3, count + 1) * width:
                b.box((x, floor + high / 2, back), (0.03, high, 0.03), frame)
    b.lean(since, -b.uniform(0, 18), (floor, back))
    if b.chance(0.35):
        since, rest = len(b.parts), seat + b.uniform(0.15, 0.28)
        b.box((width / 2, rest, 0), (0.05, 0.04, depth * 0.9), frame)
        if b.chance(0.7):
            b.box((width / 2, (rest + seat) / 2, depth * 0.35), (0.04, rest - seat, 0.04), frame)
            b.box((width / 2, (rest + seat) / 2, -depth * 0.4), (0.04, rest - seat, 0.04), frame)
        else:
            b.box((width / 2, (rest + seat) / 2, 0), (0.05, rest - seat, depth * 0.9), cloth)
        b.twin(since)


def _table(b: Builder) -> None:
    """Build a dining table, desk, coffee table or round table."""
    width, depth, height = b.uniform(0.6, 1.4), b.uniform(0.5, 0.8), b.uniform(0.3, 0.8)
    if b.chance(0.3):
        width = depth = b.uniform(0.5, 1.0)
    if b.chance(0.2):
        width, depth = depth, width
    thick, top, frame = b.uniform(0.02, 0.1), b.color(), b.color()
    if b.chance(0.4):
        top = frame
    _legs(b, width, depth, height, frame)
    if b.chance(0.25):
        b.turned((0, height, 0), [(min(width, depth) / 2, 0), (min(width, depth) / 2, thick)], top, 20)
    else:
        over = b.uniform(1, 1.12)
        b.box((0, height + thick / 2, 0), (width * over, thick, depth * over), top, bevel=0.4 * b.chance(0.3))
    if b.chance(0.3):
        apron = b.uniform(0.04, 0.15)
        b.box((0, height - apron / 2, 0), (width * 0.88, apron, depth * 0.85), frame)
    if b.chance(0.2):
        b.box((0, height * b.uniform(0.2, 0.5), 0), (width * 0.88, 0.03, depth * 0.85), frame)
    if b.chance(0.2):
        drawers = b.uniform(0.3, 0.9) * height
        b.box((width * 0.32, height - drawers / 2, 0), (width * 0.3, drawers, depth * 0.85), frame)


def _bench(b: Builder) -> None:
    """Build a bench of planks, with or without a back."""
    width, depth, seat, thick = b.uniform(1.0, 1.8), b.uniform(0.3, 0.55), b.uniform(0.3, 0.5), b.uniform(0.03, 0.08)
    wood, frame = b.color(), b.color()
    planks = int(b.rng.integers(1, 5))
    for z in (np.arange(planks) + 0.5) / planks * depth - depth / 2:
        b.box((0, seat, z), (width, thick, depth / planks * b.uniform(0.75, 1)), wood)
    inset, leg = width * b.uniform(0.36, 0.49), b.uniform(0.04, 0.1)
    solid, back = b.chance(0.3), b.chance(0.6)
    for s in (1, -1):
        if solid:
            b.box((s * inset, seat / 2, 0), (leg, seat, depth * 0.9), frame)
        else:
            for z in (depth * 0.42, -depth * 0.42):
                b.box((s * inset, seat / 2, z), (leg, seat, leg), frame)
    if not back:
        return
    since, high, rails = len(b.parts), b.uniform(0.3, 0.5), int(b.rng.integers(1, 4))
    for s in (1, -1):
        b.box((s * inset, seat + high / 2, -depth / 2), (leg, high, leg * 0.7), frame)
    for k in range(rails):
        y = seat + high * (0.35 + 0.65 * (k + 0.5) / rails)
        b.box((0, y, -depth / 2 + leg * 0.3), (width, high * 0.65 / rails * b.uniform(0.6, 1), thick), wood)
    b.lean(since, -b.uniform(0, 20), (seat, -depth / 2))
    if b.chance(0.4):
        since, rest = len(b.parts), seat + b.uniform(0.15, 0.25)
        b.box((width / 2 - leg / 2, rest, 0), (leg, leg * 0.6, depth), frame)
        b.box((width / 2 - leg / 2, (rest + seat) / 2, depth * 0.42), (leg, rest - seat, leg), frame)
        b.twin(since)


def _sofa(b: Builder) -> None:
    """Build an armchair, sofa, corner sofa or ottoman."""
    width, depth, seat = b.uniform(0.7, 2.2), b.uniform(0.7, 1.0), b.uniform(0.3, 0.48)
    cloth, foot, arm, back = b.color(), b.color(), b.uniform(0.08, 0.28), b.uniform(0.12, 0.3)
    soft = b.chance(0.5)

    def block(center: tuple[float, float, float], size: tuple[float, float, float]) -> None:
        b.cushion(center, size, cloth, b.uniform(5, 9)) if soft else b.box(
            center, size, cloth, bevel=0.2 * b.chance(0.5)
        )

    leg = b.uniform(0.03, 0.16)
    for sx, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        b.rod((sx * width * 0.45, 0, sz * depth * 0.42), (sx * width * 0.45, leg, sz * depth * 0.42), 0.03, foot, 1.3)
    block((0, (leg + seat) / 2, 0), (width, seat - leg, depth))
    if b.chance(0.08):
        return
    high = b.uniform(0.65, 1.0)
    since = len(b.parts)
    block((0, (high + leg) / 2, -depth / 2 + back / 2), (width, high - leg, back))
    b.lean(since, -b.uniform(0, 10), (leg, -depth / 2))
    rest = b.uniform(seat + 0.08, high * 0.9)
    if b.chance(0.85):
        for s in (1, -1):
            block((s * (width / 2 - arm / 2), (rest + leg) / 2, 0), (arm, rest - leg, depth))
    seats = max(1, round(width / 0.7))
    if b.chance(0.7):
        inner, tone = width - 2 * arm, np.clip(cloth * b.uniform(0.85, 1.2), 0, 1)
        for x in (np.arange(seats) + 0.5) / seats * inner - inner / 2:
            b.cushion((x, seat + 0.05, back / 2), (inner / seats, 0.16, depth - back), tone)
            if b.chance(0.6):
                b.cushion(
                    (x, (seat + high) / 2 + 0.05, -depth / 2 + back + 0.06), (inner / seats, high - seat, 0.18), tone
                )
    if b.chance(0.15) and width > 1.3:
        side = 1 if b.chance(0.5) else -1
        block((side * (width / 2 - 0.35), (leg + seat) / 2, depth * 0.8), (0.7, seat - leg, depth * 0.8))


def _bed(b: Builder) -> None:
    """Build a single, double or bunk bed."""
    width, depth, seat = b.uniform(0.8, 1.9), b.uniform(1.8, 2.2), b.uniform(0.25, 0.5)
    frame, sheet, cover, thick = (
        b.color(),
        np.clip(b.uniform(0.7, 1) + np.zeros(3), 0, 1),
        b.color(),
        b.uniform(0.12, 0.3),
    )
    low, post = b.uniform(0.0, 0.25) * b.chance(0.7), b.uniform(0.05, 0.12)
    head, foot = b.uniform(0.5, 1.2), b.uniform(0.2, 0.7) * b.chance(0.6)
    levels = [0.0, b.uniform(0.8, 1.1)] if b.chance(0.12) else [0.0]
    for level in levels:
        b.box((0, level + (low + seat) / 2, 0), (width, max(seat - low, 0.06), depth), frame)
        b.cushion((0, level + seat + thick / 2, 0), (width * 0.96, thick, depth * 0.96), sheet, 7)
        long = b.uniform(0.5, 0.75) * depth
        if b.chance(0.8):
            b.cushion((0, level + seat + thick * 0.55, (depth - long) / 2), (width * 1.02, thick * 1.1, long), cover, 8)
        pillows = 1 if width < 1.2 else 2
        for x in (np.arange(pillows) + 0.5) / pillows * width - width / 2:
            b.cushion((x, level + seat + thick + 0.05, -depth * 0.38), (width / pillows * 0.75, 0.16, 0.4), sheet, 3)
    top = levels[-1]
    if b.chance(0.9):
        head += top
        b.box((0, head / 2, -depth / 2), (width, head, b.uniform(0.04, 0.15)), frame, bevel=0.2 * b.chance(0.3))
    if foot or top:
        b.box((0, (foot + top) / 2, depth / 2), (width, foot + top, 0.06), frame) if not top else None
    for sx, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        tall = max(head if sz < 0 else foot, seat, top + seat if top else 0)
        b.box((sx * width / 2, tall / 2, sz * depth / 2), (post, tall, post), frame)


def _cabinet(b: Builder) -> None:
    """Build a cupboard, chest of drawers, shelf or night stand."""
    width, depth, height = b.uniform(0.4, 1.5), b.uniform(0.3, 0.6), b.uniform(0.4, 1.9)
    body, front = b.color(), b.color()
    if b.chance(0.5):
        front = np.clip(body * b.uniform(0.7, 1.3), 0, 1)
    leg, wall = b.uniform(0.03, 0.25) * b.chance(0.5), b.uniform(0.02, 0.05)
    if leg:
        for sx, sz in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            place = sx * (width / 2 - 0.05), sz * (depth / 2 - 0.05)
            b.box((place[0], leg / 2, place[1]), (0.05, leg, 0.05), body)
    rows, columns = int(b.rng.integers(1, 6)), int(b.rng.integers(1, 4))
    middle = leg + height / 2
    if b.chance(0.35):
        for y in np.linspace(leg + wall / 2, leg + height - wall / 2, rows + 1):
            b.box((0, y, 0), (width, wall, depth), body)
        for x in np.linspace(-width / 2 + wall / 2, width / 2 - wall / 2, 2 if b.chance(0.6) else columns + 1):
            b.box((x, middle, 0), (wall, height, depth), body)
        if b.chance(0.65):
            b.box((0, middle, -depth / 2), (width, height, wall), body)
        if b.chance(0.4):
            for _ in range(int(b.rng.integers(2, 9))):
                row, size = int(b.rng.integers(rows)), height / rows * b.uniform(0.5, 0.8)
                long = b.uniform(0.05, 0.3) * width
                x, y = b.uniform(-0.4, 0.4) * (width - long), leg + height * row / rows + wall / 2 + size / 2
                b.box((x, y, 0), (long, size, depth * b.uniform(0.5, 0.85)), b.color())
        return
    b.box((0, middle, 0), (width, height, depth), body)
    cell = width / columns, height / rows
    for x in (np.arange(columns) + 0.5) * cell[0] - width / 2:
        for y in leg + (np.arange(rows) + 0.5) * cell[1]:
            b.box((x, y, depth / 2), (cell[0] * 0.9, cell[1] * 0.9, 0.03), front)
            b.box((x, y + 0.3 * cell[1] * b.chance(0.3), depth / 2 + 0.03), (min(0.12, cell[0] / 3), 0.025, 0.03), body)
    if b.chance(0.4):
        b.box((0, leg + height, 0), (width * 1.06, 0.04, depth * 1.08), front)
    if b.chance(0.12):
        b.box((0, leg + height * 1.3, -depth * 0.3), (width, height * 0.6, depth * 0.4), body)


def _display(b: Builder) -> None:
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
        rings = []
        for z, s in ((0.0, 0.95), (-deep, b.uniform(0.5, 0.9))):
            rings.append(
                np.array(
                    [
                        [x * width * s / 2, neck + height / 2 + y * height * s / 2, z]
                        for x, y in ((-1, -1), (-1, 1), (1, 1), (1, -1))
                    ]
                )
            )
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


def _lamp(b: Builder) -> None:
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


def _wheel(b: Builder, x: float, z: float, radius: float, width: float, color: Array) -> None:
    """Add a wheel that stands on the ground."""
    b.rod((x - width / 2, radius, z), (x + width / 2, radius, z), radius, color, sides=14)


def _car(b: Builder) -> None:
    """Build a saloon, hatchback, van, pick-up, truck or sports car: a body with a cabin on wheels."""
    length, width = b.uniform(2.0, 2.6) * b.uniform(0.85, 1.1), b.uniform(0.85, 1.1)
    radius, clear, paint = b.uniform(0.17, 0.27), b.uniform(0.1, 0.2), b.color()
    tyre, glass, half = b.rng.uniform(0.02, 0.2) + np.zeros(3), b.rng.uniform(0.05, 0.5, 3), length / 2
    belt, roof = clear + b.uniform(0.3, 0.42), 0.0
    kind, power = b.rng.choice(5, p=[0.35, 0.2, 0.2, 0.15, 0.1]), b.uniform(3, 9)
    nose = belt * b.uniform(0.75, 1.0)
    body = [
        (half, width * 0.44, clear + 0.03, nose * 0.9),
        (half * 0.93, width / 2, clear, nose),
        (half * 0.35, width / 2, clear, belt),
    ]
    body += [
        (-half * 0.9, width / 2, clear, belt * b.uniform(0.9, 1.05)),
        (-half, width * 0.45, clear + 0.03, belt * 0.92),
    ]
    b.sections(body[::-1], paint, power)
    roof = belt + (b.uniform(0.55, 0.9) if kind in (2, 4) else b.uniform(0.25, 0.42))
    spans = {
        0: (0.4, 0.12, -0.45, -0.75),
        1: (0.4, 0.15, -0.8, -0.97),
        2: (0.75, 0.45, -0.96, -0.99),
        3: (0.45, 0.2, -0.1, -0.2),
        4: (0.9, 0.75, 0.25, 0.22),
    }
    front, first, last, rear = (half * (s + b.uniform(-0.05, 0.05)) for s in spans[int(kind)])
    base = width * 0.47, belt - 0.05
    rear_, front_ = max(rear, -half), min(front, half * 0.97)
    low = np.array([[s * base[0], base[1], z] for s, z in ((1, front_), (1, rear_), (-1, rear_), (-1, front_))])
    slim = b.uniform(0.72, 0.95)
    high = np.array([[s * base[0] * slim, roof, z] for s, z in ((1, first), (1, last), (-1, last), (-1, first))])
    b.loft(np.stack((low, high)), glass if b.chance(0.6) else paint)
    flat = high.copy()
    flat[:, 1] += 0.03
    b.loft(np.stack((high - [0, 0.02, 0], flat)), paint)
    if kind == 4:
        box = b.uniform(0.9, 1.35)
        b.box((0, clear + box / 2 + 0.15, -half * 0.4), (width * 1.04, box, length * 0.58), b.color())
    if b.chance(0.15):
        b.box((0, roof + 0.06, (first + last) / 2), (width * 0.5, 0.08, 0.12), b.color())
    if b.chance(0.12) and kind in (0, 1):
        b.box((0, belt + 0.15, -half * 0.93), (width * 0.9, 0.03, 0.15), paint)
        b.box((0, belt + 0.06, -half * 0.93), (width * 0.6, 0.16, 0.04), paint)
    wheel = b.uniform(0.1, 0.2)
    for s in (1, -1):
        for z in (half * b.uniform(0.56, 0.66), -half * b.uniform(0.56, 0.66)):
            _wheel(b, s * (width / 2 - wheel * 0.3), z, radius, wheel, tyre)
        b.box((s * width * 0.33, nose * 0.85, half * 0.97), (0.14, 0.07, 0.06), np.array([1.0, 1, 0.85]))


def _airplane(b: Builder) -> None:
    """Build an airliner, propeller plane, glider or jet fighter."""
    paint, second = b.color(), b.color()
    if b.chance(0.6):
        paint = np.clip(b.uniform(0.75, 1) + b.rng.normal(0, 0.03, 3), 0, 1)
    length, r = 2.0, b.uniform(0.08, 0.17)
    tail = b.uniform(0.4, 0.8)
    stations = [
        (1.0, 0.015, -0.3),
        (0.93, 0.55, -0.1),
        (0.8, 0.9, 0.0),
        (0.6, 1, 0),
        (-0.3, 1, 0),
        (-0.7, tail, 0.2),
        (-1.0, 0.12, 0.6),
    ]
    b.sections(
        [(z * length / 2, r * s, r * (y - s * b.uniform(0.98, 1.0)), r * (y + s)) for z, s, y in stations[::-1]], paint
    )

    def wing(
        root: float, chord: float, span: float, sweep: float, rise: float, y: float, taper: float, thin: float
    ) -> None:
        rings = []
        for x, z, c, up in ((0.0, root, chord, y), (span, root - sweep, chord * taper, y + rise)):
            ring = outline_wing(c, thin * c)
            rings.append(np.stack((np.full(len(ring), x), ring[:, 1] + up, ring[:, 0] + z), -1))
        since = len(b.parts)
        b.loft(np.stack(rings), paint if b.chance(0.7) else second)
        b.twin(since)

    jet, delta = b.chance(0.65), b.chance(0.12)
    span = b.uniform(0.65, 1.05) if not delta else b.uniform(0.5, 0.7)
    chord = b.uniform(0.28, 0.5) if not delta else b.uniform(0.7, 1.0)
    sweep = b.uniform(0.25, 0.6) if jet else b.uniform(0.0, 0.12)
    height = b.uniform(-0.7, -0.3) * r if b.chance(0.7) else b.uniform(0.6, 1.0) * r
    root, taper = b.uniform(0.0, 0.3), b.uniform(0.25, 0.5) if jet else b.uniform(0.5, 1)
    wing(root, chord, span, sweep, b.uniform(0, 0.15), height, taper, 0.1)
    high = b.uniform(0.25, 0.42)
    t_tail = b.chance(0.25)
    fin = np.array([[-0.68, 0.0], [-0.88, high], [-1.06, high], [-1.0, 0.0]]) + [0.0, r * 0.4]
    for x in (-0.12, 0.12) if delta else (0.0,):
        b.plate(fin, x - 0.018, x + 0.018, second)
    wing(
        -0.78,
        b.uniform(0.18, 0.28),
        b.uniform(0.28, 0.42),
        b.uniform(0.05, 0.2),
        0.03,
        (high + r * 0.3) if t_tail else r * 0.4,
        0.5,
        0.1,
    )
    where = b.rng.integers(4)
    if jet and not delta and where < 3:
        e, pairs = b.uniform(0.045, 0.085), (0.32, 0.62) if b.chance(0.2) else (0.33,)
        for share in pairs:
            since = len(b.parts)
            x = share * span if where else r + e
            z, y = (root - sweep * share + 0.12, height - e * 1.1) if where else (-0.55, r * 0.4)
            b.rod((x, y, z + 0.14), (x, y, z - 0.16), e, second, 0.7, 12)
            b.twin(since)
    elif not jet:
        if b.chance(0.5):
            since = len(b.parts)
            b.rod((0.3 * span, height, root + 0.22), (0.3 * span, height, root - 0.2), 0.055, second, 0.5)
            b.box((0.3 * span, height, root + 0.24), (0.3, 0.02, 0.01), second)
            b.twin(since)
        else:
            b.box((0, -0.3 * r, 1.02), (0.4, 0.03, 0.015), second)
    if b.chance(0.3):
        for x, z in ((0.15, 0.0), (-0.15, 0.0), (0, 0.75)):
            b.rod((x, -r, z), (x, -r - 0.1, z), 0.012, second)
            b.rod((x - 0.02, -r - 0.1, z), (x + 0.02, -r - 0.1, z), 0.05, second)


def outline_wing(chord: float, thick: float) -> Array:
    """Make an aerofoil [N, 2] of (along, up), centred."""
    x = np.array([0.5, 0.35, 0.0, -0.5, 0.0, 0.35])
    y = np.array([0.0, 0.5, 0.45, 0.0, -0.3, -0.35])
    return np.stack((x * chord, y * thick), -1)[::-1]


def _gun(b: Builder, toy: bool) -> None:
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


def _watercraft(b: Builder) -> None:
    """Build a rowing boat, motor boat, ship or sailing ship; its bow is at +z or −z."""
    _boat(b)
    if b.chance(0.5):
        b.turn()


def _boat(b: Builder) -> None:
    """Build a boat with its bow at +z."""
    length, width, deep = 2.0, b.uniform(0.35, 0.8), b.uniform(0.2, 0.4)
    paint, deck, kind = b.color(), b.color(), b.rng.choice(4, p=[0.25, 0.25, 0.25, 0.25])
    sheer, stern = b.uniform(0, 0.25), b.uniform(0.3, 0.95)
    z = np.array([-1.0, -0.8, -0.3, 0.3, 0.7, 0.92, 1.0])
    half = width / 2 * np.array([stern, 0.5 + stern / 2, 1, 0.97, 0.65, 0.25, 0.02])
    top = deep + sheer * np.array([0.5, 0.3, 0.02, 0.05, 0.4, 0.8, 1]) * 1.0
    keel = deep * np.array([0.25, 0.08, 0, 0, 0.1, 0.35, 0.7])

    def ring(k: int, scale: float, floor: float, rim: float) -> Array:
        w, low, high = half[k] * scale, keel[k] + floor, top[k] + rim
        mid = low + 0.45 * (high - low)
        points = [(w, high), (0.92 * w, mid), (0.45 * w, low), (-0.45 * w, low), (-0.92 * w, mid), (-w, high)]
        return np.array([[x, y, z[k] * length / 2 * (0.5 + 0.5 * scale)] for x, y in points])

    b.loft(np.stack([ring(k, 1, 0, 0) for k in range(7)]), paint)
    if kind == 0:
        since = len(b.parts)  # walls above the hull leave a hollow
        for first, last in zip(range(6), range(1, 7), strict=True):
            corners = [
                (half[k] * s, top[k] + up, z[k] * length / 2)
                for k in (first, last)
                for s, up in ((1, 0.0), (0.9, 0.0), (0.94, 0.13), (1.06, 0.13))
            ]
            b.loft(np.array(corners).reshape(2, 4, 3), paint)
        b.twin(since)
        b.box((0, deep + 0.12, -1.0 * length / 2 + 0.02), (half[0] * 2, 0.2, 0.04), paint)
        for place in (-0.4, 0.15):
            b.box((0, deep + 0.1, place), (width * 0.9, 0.03, 0.14), deck)
        return
    place = b.uniform(-0.45, 0.1)
    if kind in (1, 2):
        floors, w, long = (
            int(b.rng.integers(1, 4 if kind == 2 else 3)),
            width * b.uniform(0.5, 0.8),
            b.uniform(0.4, 1.1 if kind == 2 else 0.7),
        )
        y = deep + sheer * 0.05
        for _ in range(floors):
            high = b.uniform(0.14, 0.28)
            b.box((0, y + high / 2, place), (w, high, long), deck, b.uniform(0.85, 1))
            y, w, long = y + high, w * b.uniform(0.75, 1), long * b.uniform(0.55, 0.95)
        if b.chance(0.5):
            b.rod((0, y, place), (0, y + b.uniform(0.15, 0.5), place), b.uniform(0.02, 0.09), b.color())
        if kind == 2 and b.chance(0.4):
            for k in range(int(b.rng.integers(2, 5))):
                b.box((0, deep + 0.12, 0.25 + 0.17 * k), (width * 0.6, 0.2, 0.15), b.color())
        if b.chance(0.3):
            b.rod((0, deep, 0.5), (0, deep + b.uniform(0.3, 0.7), 0.45), 0.018, paint)
        return
    masts, sail = int(b.rng.integers(1, 4)), np.clip(b.uniform(0.7, 1) + b.rng.normal(0, 0.05, 3), 0, 1)
    for m in (np.arange(masts) + 0.5) / masts * 1.3 - 0.65:
        high = b.uniform(1.0, 1.9) * (1.2 if masts == 1 else 0.85)
        b.rod((0, deep * 0.5, m), (0, deep + high, m), 0.025, deck, 0.6)
        if masts == 1 or b.chance(0.3):
            boom = b.uniform(0.5, 0.85)
            b.plate(
                np.array([[m - 0.03, deep + 0.15], [m - 0.03, deep + high], [m - boom, deep + 0.15]]),
                -0.012,
                0.012,
                sail,
            )
            if b.chance(0.6):
                b.plate(
                    np.array([[m + 0.05, deep + 0.9 * high], [m + 0.05, deep + 0.2], [0.95, deep + 0.1]]),
                    -0.012,
                    0.012,
                    sail,
                )
        else:
            rows = int(b.rng.integers(1, 4))
            for k in range(rows):
                y, w = deep + high * (0.25 + 0.72 * (k + 0.5) / rows), width * b.uniform(1.0, 1.5) * (1 - 0.15 * k)
                b.box((0, y, m + 0.05), (w, 0.72 * high / rows * 0.85, 0.05), sail, 0.9)
    if b.chance(0.5):
        b.box((0, deep + 0.15, -0.75), (width * 0.75, 0.25, 0.4), deck)


GRAMMARS: dict[str, Callable[[Builder], None]] = {
    "airplane": _airplane,
    "bed": _bed,
    "bench": _bench,
    "blaster": lambda b: _gun(b, True),
    "cabinet": _cabinet,
    "car": _car,
    "chair": _chair,
    "display": _display,
    "lamp": _lamp,
    "rifle": lambda b: _gun(b, False),
    "sofa": _sofa,
    "table": _table,
    "watercraft": _watercraft,
}
"""Category → function that builds a random object of it."""
