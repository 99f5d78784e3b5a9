"""Grammars of cars, airplanes and watercraft, built from parts.

Lengths are relative; a shape is scaled to a longest side of 1 afterwards. The front of an object is at +z.
"""

from __future__ import annotations

import numpy as np

from .parts import Array, Builder


def _wheel(b: Builder, x: float, z: float, radius: float, width: float, color: Array) -> None:
    """Add a wheel that stands on the ground."""
    b.rod((x - width / 2, radius, z), (x + width / 2, radius, z), radius, color, sides=14)


def car(b: Builder) -> None:
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
    wheel, axles = b.uniform(0.1, 0.2), (half * b.uniform(0.56, 0.66), -half * b.uniform(0.56, 0.66))
    if kind == 3 and b.chance(0.7):  # the bed of a pick-up
        bed = belt + b.uniform(-0.2, -0.05)
        b.box((0, bed + 0.5, (rear - half) / 2), (width * 0.86, 1, (rear + half) * 0.88), paint)
        b.cut(0)
    if b.chance(0.6):  # wheel arches
        for z in axles:
            b.rod((-width, radius, z), (width, radius, z), radius * b.uniform(1.1, 1.3), paint, sides=14)
            b.cut(0)
    for s in (1, -1):
        for z in axles:
            _wheel(b, s * (width / 2 - wheel * 0.3), z, radius, wheel, tyre)
        b.box((s * width * 0.33, nose * 0.85, half * 0.97), (0.14, 0.07, 0.06), np.array([1.0, 1, 0.85]))


def airplane(b: Builder) -> None:
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
            ring = _airfoil(c, thin * c)
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


def _airfoil(chord: float, thick: float) -> Array:
    """Make an aerofoil [N, 2] of (along, up), centred."""
    x = np.array([0.5, 0.35, 0.0, -0.5, 0.0, 0.35])
    y = np.array([0.0, 0.5, 0.45, 0.0, -0.3, -0.35])
    return np.stack((x * chord, y * thick), -1)[::-1]


def watercraft(b: Builder) -> None:
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

    def ring(k: int, scale: float, lift: float, rim: float) -> Array:
        w, low, high = half[k] * scale, keel[k] + lift, top[k] + rim
        mid = low + 0.45 * (high - low)
        points = [(w, high), (0.92 * w, mid), (0.45 * w, low), (-0.45 * w, low), (-0.92 * w, mid), (-w, high)]
        return np.array([[x, y, z[k] * length / 2 * (0.5 + 0.5 * scale)] for x, y in points])

    b.loft(np.stack([ring(k, 1, 0, 0) for k in range(7)]), paint)
    if kind == 0:
        floor = b.uniform(0.15, 0.3) * deep
        b.loft(np.stack([ring(k, 0.86, floor, 0.2) for k in range(7)]), paint)
        b.cut(0)
        for place in (-0.4, 0.15):
            b.box((0, deep * 0.75, place), (width * 0.9, 0.04, 0.14), deck)
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
