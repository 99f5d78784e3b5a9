"""The 13 categories of the free models, each with a function that builds a random object from parts."""

from __future__ import annotations

from collections.abc import Callable

from . import devices, furniture, vehicles
from .parts import Builder

GRAMMARS: dict[str, Callable[[Builder], None]] = {
    "airplane": vehicles.airplane,
    "bed": furniture.bed,
    "bench": furniture.bench,
    "blaster": lambda b: devices.gun(b, True),
    "cabinet": furniture.cabinet,
    "car": vehicles.car,
    "chair": furniture.chair,
    "display": devices.display,
    "lamp": devices.lamp,
    "rifle": lambda b: devices.gun(b, False),
    "sofa": furniture.sofa,
    "table": furniture.table,
    "watercraft": vehicles.watercraft,
}
"""Category → function that builds a random object of it."""
