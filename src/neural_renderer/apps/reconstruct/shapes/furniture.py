"""Grammars of furniture: chairs, tables, benches, sofas, beds and cabinets, built from parts.

Lengths are relative; a shape is scaled to a longest side of 1 afterwards. The front of an object is at +z.
"""

from __future__ import annotations

import numpy as np

from .parts import CORNERS, Array, Builder


def _legs(b: Builder, width: float, depth: float, top: float, color: Array) -> None:
    """Add four legs, a pedestal, a sled or two side panels under a rectangle at height ``top``."""
    kind = b.rng.choice(5, p=[0.5, 0.15, 0.12, 0.13, 0.1])
    radius, splay = b.uniform(0.015, 0.05), b.uniform(0, 0.1) * b.chance(0.4)
    x, z = width / 2 - radius * b.uniform(1, 2.5), depth / 2 - radius * b.uniform(1, 2.5)
    if kind == 0:
        square = b.chance(0.55)
        for sx, sz in CORNERS:
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
        since, long = len(b.parts), depth * b.uniform(0.7, 1)
        for s in (1, -1):
            b.box((s * x, top / 2, 0), (2 * radius, top, long), color)
        if b.chance(0.4):
            b.box((0, top * b.uniform(0.4, 0.55), 0), (width * 2, top * 0.7, long * b.uniform(0.5, 0.8)), color)
            b.cut(since)
    else:
        arms = int(b.rng.integers(3, 6))
        b.rod((0, 0.06, 0), (0, top, 0), radius * 1.3, color)
        for angle in 2 * np.pi * np.arange(arms) / arms:
            end = 0.45 * min(width, depth) * np.array([np.cos(angle), 0, np.sin(angle)])
            b.rod((0, 0.08, 0), end + [0, radius, 0], radius, color)


def chair(b: Builder) -> None:
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
        if b.chance(0.4):
            hole = width * b.uniform(0.3, 0.7), high * b.uniform(0.2, 0.6), 1
            b.box((0, floor + high * b.uniform(0.45, 0.65), back), hole, cloth)
            b.cut(since)
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


def table(b: Builder) -> None:
    """Build a dining table, desk, coffee table or round table."""
    width, depth, height = b.uniform(0.6, 1.4), b.uniform(0.5, 0.8), b.uniform(0.3, 0.8)
    if b.chance(0.3):
        width = depth = b.uniform(0.5, 1.0)
    if b.chance(0.2):
        width, depth = depth, width
    thick, top, frame = b.uniform(0.02, 0.1), b.color(), b.color()
    if b.chance(0.4):
        top = frame
    if b.chance(0.1):  # a block with room for knees
        b.box((0, height / 2, 0), (width * 0.96, height, depth * 0.96), frame)
        knees = b.uniform(0.4, 0.85) * width, b.uniform(0.75, 0.95) * height, depth * b.uniform(0.8, 2)
        b.box((width * b.uniform(-0.05, 0.05), knees[1] / 2 - 0.01, depth / 2), knees, frame)
        b.cut(0)
    else:
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


def bench(b: Builder) -> None:
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


def sofa(b: Builder) -> None:
    """Build an armchair, sofa, corner sofa or ottoman."""
    width, depth, seat = b.uniform(0.7, 2.2), b.uniform(0.7, 1.0), b.uniform(0.3, 0.48)
    cloth, foot, arm, back = b.color(), b.color(), b.uniform(0.08, 0.28), b.uniform(0.12, 0.3)
    soft = b.chance(0.5)

    def block(center: tuple[float, float, float], size: tuple[float, float, float]) -> None:
        b.cushion(center, size, cloth, b.uniform(5, 9)) if soft else b.box(
            center, size, cloth, bevel=0.2 * b.chance(0.5)
        )

    leg = b.uniform(0.03, 0.16)
    for sx, sz in CORNERS:
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


def bed(b: Builder) -> None:
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
        if b.chance(0.25):
            opening = width * b.uniform(0.4, 0.8), (head - top) * b.uniform(0.15, 0.3), 1
            b.box((0, top + (head - top) * 0.8, -depth / 2), opening, frame)
            b.cut(len(b.parts) - 2)
    if foot or top:
        b.box((0, (foot + top) / 2, depth / 2), (width, foot + top, 0.06), frame) if not top else None
    for sx, sz in CORNERS:
        tall = max(head if sz < 0 else foot, seat, top + seat if top else 0)
        b.box((sx * width / 2, tall / 2, sz * depth / 2), (post, tall, post), frame)


def cabinet(b: Builder) -> None:
    """Build a cupboard, chest of drawers, shelf or night stand."""
    width, depth, height = b.uniform(0.4, 1.5), b.uniform(0.3, 0.6), b.uniform(0.4, 1.9)
    body, front = b.color(), b.color()
    if b.chance(0.5):
        front = np.clip(body * b.uniform(0.7, 1.3), 0, 1)
    leg, wall = b.uniform(0.03, 0.25) * b.chance(0.5), b.uniform(0.02, 0.05)
    if leg:
        for sx, sz in CORNERS:
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
    niche = int(b.rng.integers(rows)) if b.chance(0.3) else -1
    if niche >= 0:  # an open row
        b.box((0, leg + (niche + 0.5) * cell[1], wall), (width - 2 * wall, cell[1] - wall, depth), front)
        b.cut(len(b.parts) - 2)
    for x in (np.arange(columns) + 0.5) * cell[0] - width / 2:
        for y in leg + (np.delete(np.arange(rows), [niche] if niche >= 0 else []) + 0.5) * cell[1]:
            b.box((x, y, depth / 2), (cell[0] * 0.9, cell[1] * 0.9, 0.03), front)
            b.box((x, y + 0.3 * cell[1] * b.chance(0.3), depth / 2 + 0.03), (min(0.12, cell[0] / 3), 0.025, 0.03), body)
    if b.chance(0.4):
        b.box((0, leg + height, 0), (width * 1.06, 0.04, depth * 1.08), front)
    if b.chance(0.12):
        b.box((0, leg + height * 1.3, -depth * 0.3), (width, height * 0.6, depth * 0.4), body)
