"""Models of all kinds of actors: cars, vans, people, obstacles; in the actor's frame, see `shapes`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from raw2drive_ros.simulation.looks import PAINTS
from raw2drive_ros.simulation.shapes import Colour, Quad, Shape, Span, box, floor, frustum, plate, shape_of, side_plates

GLASS, TYRE, SHADE = (35.0, 45.0, 60.0), (22.0, 22.0, 24.0), (40.0, 40.0, 43.0)
SKINS = ((205.0, 160.0, 130.0), (150.0, 105.0, 80.0), (95.0, 65.0, 50.0))
TROUSERS = ((50.0, 50.0, 80.0), (45.0, 45.0, 45.0), (105.0, 90.0, 70.0), (70.0, 85.0, 105.0))
HELMETS = ((230.0, 230.0, 90.0), (235.0, 235.0, 235.0), (200.0, 50.0, 40.0))
TAIL_COLOURS = {'off': (110.0, 15.0, 15.0), 'day': (110.0, 15.0, 15.0), 'night': (150.0, 12.0, 10.0)}
BRAKE_LIT, HEADLAMP, HEADLAMP_OFF = (255.0, 40.0, 25.0), (255.0, 252.0, 225.0), (170.0, 170.0, 165.0)
AMBER = (255.0, 150.0, 10.0)
# Flashing lights: (left, right) in either phase.
FLASH = (((20.0, 60.0, 255.0), (90.0, 15.0, 15.0)), ((10.0, 20.0, 90.0), (255.0, 30.0, 30.0)))
WHEEL_RADIUS_M, SKIRT_M = 0.33, 0.28


@dataclass(frozen=True, slots=True)
class Cabin:
    """The glazed upper part of a car. waist: height of its lower edge as a share of the car's height. foot, roof:
    (back, front) of its lower and upper edge as shares of half the car's length. bed: a loading bed behind it."""

    waist: float
    foot: tuple[float, float]
    roof: tuple[float, float]
    bed: bool = False


CABINS = {
    'sedan': Cabin(0.62, (-0.76, 0.42), (-0.45, 0.1)),
    'hatchback': Cabin(0.6, (-0.96, 0.46), (-0.76, 0.12)),
    'suv': Cabin(0.58, (-0.96, 0.5), (-0.88, 0.2)),
    'pickup': Cabin(0.56, (-0.16, 0.5), (-0.1, 0.2), bed=True),
    'minivan': Cabin(0.55, (-0.98, 0.72), (-0.9, 0.36)),
    'coupe': Cabin(0.64, (-0.82, 0.3), (-0.36, -0.02)),
    'notchback': Cabin(0.61, (-0.7, 0.46), (-0.5, 0.16)),
    'wagon': Cabin(0.6, (-0.97, 0.4), (-0.84, 0.08)),
    'crossover': Cabin(0.6, (-0.94, 0.52), (-0.66, 0.2)),
    'saloon': Cabin(0.63, (-0.7, 0.36), (-0.38, 0.04)),
    'city_car': Cabin(0.57, (-0.97, 0.62), (-0.88, 0.3)),
    'estate': Cabin(0.61, (-0.98, 0.44), (-0.92, 0.14)),
    'off_roader': Cabin(0.57, (-0.98, 0.4), (-0.95, 0.3)),
    'crew_cab': Cabin(0.55, (-0.34, 0.48), (-0.26, 0.22), bed=True),
}
# Actors without an explicit body.
CABINS |= {'car': CABINS['sedan'], 'parked': CABINS['sedan']}


@dataclass(frozen=True, slots=True)
class Hull:
    """A van. bonnet: share of its length that a bonnet takes. cab: height of the driver's cab as a share of the van's
    height; below 1, a box stands behind it. box_from: where the box begins, as a share of half the length."""

    bonnet: float = 0.0
    cab: float = 1.0
    box_from: float = 1.0


HULLS = {
    'van': Hull(),
    'parked_van': Hull(),
    'panel_van': Hull(bonnet=0.12),
    'box_truck': Hull(cab=0.8, box_from=0.5),
    'high_roof': Hull(bonnet=0.09),
    'transporter': Hull(bonnet=0.16),
    'luton': Hull(bonnet=0.06, cab=0.75, box_from=0.42),
}


@lru_cache(maxsize=8192)
def actor_shape(
    body: str,
    colour: int,
    size_m: tuple[float, float, float],
    lamps: str,
    phase: int,
    *,
    detailed: bool,
    indicator: str = '',
) -> Shape:
    """A body of (length, width, height) `size_m`.

    colour: index into `looks.PAINTS`. lamps: 'off', 'day', 'night' or 'brake'. phase: 0 or 1, of flashing lights and
    of walking legs. detailed: with wheels, side windows and shadow. indicator: 'left' or 'right' while that one is lit.
    Raises KeyError for an unknown body.
    """
    length, width, height = size_m
    half_l, half_w = length / 2, width / 2
    paint: Colour = tuple(float(part) for part in PAINTS[colour % len(PAINTS)])
    if body in CABINS:
        quads = _car(CABINS[body], half_l, half_w, height, paint, lamps, detailed=detailed)
        waist = height * CABINS[body].waist
        quads += _indicators(half_l, half_w, (waist - 0.34, waist - 0.06), indicator)
    elif body in HULLS:
        quads = _van(HULLS[body], half_l, half_w, height, paint, lamps, detailed=detailed)
        quads += _indicators(half_l, half_w, (0.75, 1.1), indicator)
    elif body in ('emergency', 'parked_emergency'):
        quads = _van(Hull(bonnet=0.1), half_l, half_w, height, (240.0, 240.0, 235.0), lamps, detailed=detailed)
        quads += _emergency(half_l, half_w, height, phase)
        quads += _indicators(half_l, half_w, (0.75, 1.1), indicator)
    else:
        quads = SMALL[body](half_l, half_w, height, paint, colour, phase)
    return shape_of(quads)


def _car(
    cabin: Cabin, half_l: float, half_w: float, height: float, paint: Colour, lamps: str, *, detailed: bool
) -> list[Quad]:
    waist = height * cabin.waist
    along, across = (-half_l, half_l), (-half_w, half_w)
    quads = _under(half_l, half_w) if detailed else []
    quads += box(along, across, (SKIRT_M, waist), paint)
    if cabin.bed:
        quads.append(floor((-half_l * 0.95, half_l * cabin.foot[0]), (-half_w * 0.85, half_w * 0.85), waist, SHADE))
    if detailed:
        quads += _wheels(half_l, half_w)
    foot, roof = ((half_l * back, half_l * front) for back, front in (cabin.foot, cabin.roof))
    narrow, narrower = (-half_w * 0.92, half_w * 0.92), (-half_w * 0.76, half_w * 0.76)
    quads += frustum(foot, roof, narrow, narrower, (waist, height), GLASS, paint)
    quads += _lamps(half_l, half_w, (waist - 0.32, waist - 0.08), lamps)
    if lamps == 'brake':
        quads.append(
            plate(foot[0] - 0.04, (-0.35, 0.35), (waist + 0.02, waist + 0.14), BRAKE_LIT, front=False, emissive=True)
        )
    return quads


def _van(
    hull: Hull, half_l: float, half_w: float, height: float, paint: Colour, lamps: str, *, detailed: bool
) -> list[Quad]:
    nose = half_l * (1.0 - 2.0 * hull.bonnet)
    cab = height * hull.cab
    glass_z = (cab * 0.55, cab * 0.88)
    across = (-half_w, half_w)
    quads = _under(half_l, half_w) if detailed else []
    if hull.cab < 1.0:
        white = (228.0, 228.0, 224.0)
        quads += box((-half_l, half_l * hull.box_from), across, (0.6, height), white)
        quads += box((half_l * hull.box_from, nose), across, (SKIRT_M, cab), paint)
    else:
        quads += box((-half_l, nose), across, (SKIRT_M, height), paint)
        quads.append(plate(-half_l - 0.01, (-half_w * 0.75, half_w * 0.75), glass_z, GLASS, front=False))
    quads.append(plate(nose + 0.01, (-half_w * 0.88, half_w * 0.88), glass_z, GLASS, front=True))
    if hull.bonnet:
        quads += box((nose, half_l), across, (SKIRT_M, cab * 0.5), paint)
    if detailed:
        window = (max(half_l * 0.45, half_l * hull.box_from if hull.cab < 1.0 else 0.0) + 0.05, nose - 0.15)
        quads += side_plates(window, half_w + 0.01, glass_z, GLASS)
        quads += _wheels(half_l, half_w)
    quads += _lamps(half_l, half_w, (0.75, 1.05), lamps)
    if lamps == 'brake':
        quads.append(
            plate(-half_l - 0.02, (-0.35, 0.35), (height - 0.2, height - 0.06), BRAKE_LIT, front=False, emissive=True)
        )
    return quads


def _under(half_l: float, half_w: float) -> list[Quad]:
    """The dark area below a car."""
    along, across = (-half_l - 0.05, half_l + 0.05), (-half_w - 0.05, half_w + 0.05)
    return [floor(along, across, 0.01, SHADE, counted=False)]


def _wheels(half_l: float, half_w: float) -> list[Quad]:
    quads: list[Quad] = []
    for x in (-half_l * 0.62, half_l * 0.62):
        along = (x - WHEEL_RADIUS_M, x + WHEEL_RADIUS_M)
        quads += side_plates(along, half_w + 0.01, (0.0, 2 * WHEEL_RADIUS_M), TYRE)
    return quads


def _lamps(half_l: float, half_w: float, z: Span, lamps: str) -> list[Quad]:
    braking, off = lamps == 'brake', lamps == 'off'
    tail = BRAKE_LIT if braking else TAIL_COLOURS[lamps]
    quads = []
    for y in ((-half_w * 0.98, -half_w * 0.55), (half_w * 0.55, half_w * 0.98)):
        quads.append(plate(-half_l - 0.02, y, z, tail, front=False, emissive=lamps in ('night', 'brake')))
        quads.append(plate(half_l + 0.02, y, z, HEADLAMP_OFF if off else HEADLAMP, front=True, emissive=not off))
    return quads


def _indicators(half_l: float, half_w: float, z: Span, indicator: str) -> list[Quad]:
    """The lit amber lamps of one side: at the front, at the back, and at the corners of the flank."""
    if not indicator:
        return []
    side = 1.0 if indicator == 'left' else -1.0
    inner, outer = sorted((side * half_w * 0.6, side * (half_w + 0.03)))
    quads = [
        plate(half_l + 0.03, (inner, outer), z, AMBER, front=True, emissive=True),
        plate(-half_l - 0.03, (inner, outer), z, AMBER, front=False, emissive=True),
    ]
    for along in ((half_l - 0.4, half_l + 0.03), (-half_l - 0.03, -half_l + 0.4)):
        left, right = side_plates(along, half_w + 0.03, z, AMBER, emissive=True)
        quads.append(left if side > 0.0 else right)
    return quads


def _emergency(half_l: float, half_w: float, height: float, phase: int) -> list[Quad]:
    """A stripe around the body, and two lights on the roof that flash alternately."""
    stripe = (210.0, 40.0, 30.0)
    quads = [*side_plates((-half_l, half_l * 0.8), half_w + 0.02, (1.1, 1.4), stripe)]
    quads.append(plate(-half_l - 0.02, (-half_w, half_w), (1.1, 1.3), stripe, front=False))
    left, right = FLASH[phase]
    quads += box((-0.3, 0.3), (-half_w * 0.8, 0.0), (height, height + 0.25), right, emissive=True)
    quads += box((-0.3, 0.3), (0.0, half_w * 0.8), (height, height + 0.25), left, emissive=True)
    return quads


def _walker(_half_l: float, _half_w: float, height: float, paint: Colour, colour: int, phase: int) -> list[Quad]:
    stride = 0.16 if phase else -0.16
    trousers, skin = TROUSERS[colour % len(TROUSERS)], SKINS[colour % len(SKINS)]
    hip, neck = 0.49 * height, 0.83 * height
    quads = box((stride - 0.1, stride + 0.1), (0.03, 0.19), (0.0, hip), trousers)
    quads += box((-stride - 0.1, -stride + 0.1), (-0.19, -0.03), (0.0, hip), trousers)
    quads += box((-0.16, 0.16), (-0.28, 0.28), (hip, neck), paint)
    quads += box((-0.12, 0.12), (-0.12, 0.12), (neck, height), skin)
    return quads


def _cyclist(_half_l: float, _half_w: float, _height: float, paint: Colour, colour: int, _phase: int) -> list[Quad]:
    quads = box((-0.9, -0.25), (-0.04, 0.04), (0.0, 0.65), TYRE)
    quads += box((0.25, 0.9), (-0.04, 0.04), (0.0, 0.65), TYRE)
    quads += box((-0.2, 0.15), (-0.16, 0.16), (0.3, 0.9), TROUSERS[colour % len(TROUSERS)])
    quads += box((-0.3, 0.2), (-0.22, 0.22), (0.85, 1.4), paint)
    quads += box((0.0, 0.25), (-0.12, 0.12), (1.4, 1.7), HELMETS[colour % len(HELMETS)])
    return quads


def _cone(_half_l: float, _half_w: float, _height: float, _paint: Colour, _colour: int, _phase: int) -> list[Quad]:
    quads = box((-0.22, 0.22), (-0.22, 0.22), (0.0, 0.1), (40.0, 40.0, 40.0))
    quads += box((-0.14, 0.14), (-0.14, 0.14), (0.1, 0.5), (255.0, 110.0, 20.0))
    quads += box((-0.07, 0.07), (-0.07, 0.07), (0.5, 0.8), (250.0, 250.0, 250.0))
    return quads


def _door(half_l: float, half_w: float, height: float, paint: Colour, _colour: int, _phase: int) -> list[Quad]:
    return box((-half_l, half_l), (-half_w, half_w), (0.3, height), paint)


def _barrier(half_l: float, half_w: float, height: float, _paint: Colour, _colour: int, _phase: int) -> list[Quad]:
    quads = box((-half_l, half_l), (-half_w, half_w), (0.0, 0.6), (230.0, 225.0, 220.0))
    quads += box((-half_l, half_l), (-half_w, half_w), (0.6, height), (220.0, 60.0, 30.0))
    return quads


Builder = Callable[[float, float, float, Colour, int, int], list[Quad]]
SMALL: dict[str, Builder] = {
    'walker': _walker,
    'cyclist': _cyclist,
    'cone': _cone,
    'door': _door,
    'barrier': _barrier,
}
