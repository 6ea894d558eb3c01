"""Bodies, sizes and paints of all actors. Each split (`draws.split_of_seed`) has bodies and paints of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raw2drive_ros.simulation.draws import EVALUATION, TRAINING, VALIDATION

# kind: (length, width, height) in metres.
SIZES_M = {
    'car': (4.6, 1.9, 1.5),
    'van': (5.6, 2.1, 2.3),
    'emergency': (5.4, 2.1, 2.2),
    'cyclist': (1.8, 0.6, 1.7),
    'walker': (0.6, 0.6, 1.75),
    'barrier': (3.0, 2.2, 1.1),
    'cone': (0.45, 0.45, 0.8),
    'parked': (4.6, 1.9, 1.5),
    'parked_van': (5.6, 2.1, 2.5),
    'parked_emergency': (5.4, 2.1, 2.2),
    'door': (0.15, 0.95, 1.35),
}
# Bodies of cars and vans: (length, width, height) in metres. Other kinds have the size in `SIZES_M`.
CARS_M: dict[str, dict[str, tuple[float, float, float]]] = {
    TRAINING: {
        'sedan': (4.6, 1.85, 1.45),
        'hatchback': (4.0, 1.75, 1.5),
        'suv': (4.7, 1.95, 1.75),
        'pickup': (5.2, 1.95, 1.8),
        'minivan': (4.9, 1.95, 1.78),
        'coupe': (4.4, 1.85, 1.34),
    },
    VALIDATION: {
        'notchback': (4.3, 1.76, 1.44),
        'wagon': (4.8, 1.85, 1.5),
        'crossover': (4.35, 1.83, 1.62),
    },
    EVALUATION: {
        'saloon': (4.9, 1.9, 1.47),
        'city_car': (3.65, 1.66, 1.52),
        'estate': (4.65, 1.82, 1.48),
        'off_roader': (4.5, 1.94, 1.86),
        'crew_cab': (5.35, 1.98, 1.84),
    },
}
VANS_M: dict[str, dict[str, tuple[float, float, float]]] = {
    TRAINING: {'panel_van': (5.6, 2.1, 2.4), 'box_truck': (6.1, 2.2, 2.7)},
    VALIDATION: {'high_roof': (5.9, 2.05, 2.6)},
    EVALUATION: {'transporter': (5.3, 2.05, 2.2), 'luton': (6.0, 2.2, 2.8)},
}
BODIES_M = {name: size for table in (CARS_M, VANS_M) for bodies in table.values() for name, size in bodies.items()}
CAR_KINDS = frozenset(('car', 'parked', 'van', 'parked_van'))

# RGB. An index into this list is what `Look.colour` holds.
_PAINTS: Mapping[str, tuple[tuple[int, int, int], ...]] = {
    TRAINING: (
        (178, 34, 34),
        (30, 70, 150),
        (225, 225, 225),
        (40, 40, 45),
        (120, 125, 130),
        (20, 100, 60),
        (200, 160, 40),
        (90, 50, 110),
        (175, 180, 188),
        (235, 120, 35),
        (110, 160, 205),
        (105, 70, 45),
        (190, 175, 145),
        (20, 45, 75),
        (240, 238, 230),
        (75, 80, 88),
        (130, 20, 45),
        (60, 130, 120),
    ),
    VALIDATION: (
        (205, 60, 50),
        (52, 92, 120),
        (208, 210, 214),
        (28, 30, 34),
        (148, 150, 146),
        (96, 112, 60),
        (222, 190, 110),
        (82, 62, 60),
    ),
    EVALUATION: (
        (150, 30, 30),
        (62, 98, 180),
        (234, 234, 238),
        (55, 54, 52),
        (100, 106, 116),
        (46, 84, 40),
        (216, 176, 70),
        (120, 84, 132),
        (160, 166, 176),
        (214, 96, 60),
        (88, 140, 150),
        (134, 96, 66),
    ),
}
PAINTS = tuple(paint for paints in _PAINTS.values() for paint in paints)
# split: indices into `PAINTS`.
PAINTS_OF: dict[str, range] = {}
for _split, _paints in _PAINTS.items():
    _first = sum(map(len, PAINTS_OF.values()))
    PAINTS_OF[_split] = range(_first, _first + len(_paints))


def bodies_of(kind: str, split: str) -> tuple[str, ...]:
    """The bodies that actors of a kind may have in a split."""
    if kind in ('car', 'parked'):
        return tuple(CARS_M[split])
    if kind in ('van', 'parked_van'):
        return tuple(VANS_M[split])
    return (kind,)


def size_m(body: str) -> tuple[float, float, float]:
    """(length, width, height) of a body in metres. Raises KeyError."""
    return BODIES_M.get(body) or SIZES_M[body]


def look_fields(kind: str, split: str, rng: Any, spread: float) -> tuple[str, int, float]:
    """(body, index of its paint, factor on length and width), drawn from what a split owns."""
    bodies, paints = bodies_of(kind, split), PAINTS_OF[split]
    scale = 1.0 + spread * (2.0 * float(rng.random()) - 1.0) if kind in CAR_KINDS else 1.0
    return bodies[int(rng.integers(len(bodies)))], paints[int(rng.integers(len(paints)))], scale
