"""Food and organs: spheres deformed by smooth formulae, as closed surfaces. Lengths in [m], angles in [rad]."""

from __future__ import annotations

import numpy as np
import trimesh

from defgrasp_ros.mesh.rounding import with_rounded_edges
from defgrasp_ros.mesh.shapes import kidney_surface
from defgrasp_ros.objects.primitives import Surface, unit_sphere


def banana(length: float, thickness: float, bend: float) -> Surface:
    """Return a tapered rod bent to an arc of angle ``bend``, lying on its side; five-sided like the fruit."""
    vertices, triangles = unit_sphere()
    along, across, up = vertices.T
    # The sphere's own taper is too pointed: the power makes the middle fuller.
    radius = np.hypot(across, up)
    full = np.where(radius > 1e-12, radius**0.5 / np.maximum(radius, 1e-12), 0.0)
    angle = np.arctan2(up, across)
    section = thickness / 2.0 * (1.0 + 0.035 * np.cos(5.0 * angle))
    y, z = across * full * section, up * full * section
    stretch = np.sign(along) * np.abs(along) ** 0.9
    arc_radius = length / bend
    phi = stretch * bend / 2.0
    centre = arc_radius - y
    x = centre * np.sin(phi)
    y = arc_radius - centre * np.cos(phi)
    return np.column_stack([x, y, z]), triangles


def strawberry(width: float, height: float) -> Surface:
    """Return a rounded cone that stands on its broad end."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    taper = 1.0 - 0.38 * z - 0.08 * z**2
    scale = width / 2.0 / (taper * np.sqrt(1.0 - z**2)).max()
    dent = 0.12 * np.exp(-(x**2 + y**2) / 0.1) * (z < 0.0)
    return np.column_stack([scale * taper * x, scale * taper * y, height / 2.0 * (z + dent)]), triangles


def lemon(length: float, width: float) -> Surface:
    """Return an ellipsoid with a tip at both ends, lying on its side."""
    vertices, triangles = unit_sphere()
    along, y, z = vertices.T
    tip = np.abs(along) ** 12
    body = length / 2.0 * (0.84 * along + 0.16 * np.sign(along) * tip)
    return np.column_stack([body, width / 2.0 * y, width / 2.0 * z]), triangles


def apple(width: float, height: float) -> Surface:
    """Return a round body with hollows at stalk and calyx and five faint ribs."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    from_axis = x**2 + y**2
    ribs = 1.0 + 0.02 * np.cos(5.0 * np.arctan2(y, x)) * from_axis * (1.0 - z) / 2.0
    wide = 1.0 + 0.06 * z
    hollow = 0.3 * np.exp(-from_axis / 0.07) * np.sign(z) * np.where(z > 0.0, 1.0, 0.5)
    scale = width / 2.0 / wide.max()
    return np.column_stack([scale * wide * ribs * x, scale * wide * ribs * y, height / 2.0 * (z - hollow)]), triangles


def tomato(width: float, height: float) -> Surface:
    """Return a flattened ball with lobes and a hollow at the stalk."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    from_axis = x**2 + y**2
    lobes = 1.0 + 0.03 * np.cos(6.0 * np.arctan2(y, x)) * from_axis * (1.0 + z) / 2.0
    hollow = 0.22 * np.exp(-from_axis / 0.08) * (z > 0.0)
    flat = np.sign(z) * np.abs(z) ** 1.0 * np.where(z < -0.8, 0.0, 1.0) + np.where(z < -0.8, -0.8, 0.0)
    return np.column_stack(
        [width / 2.0 * lobes * x, width / 2.0 * lobes * y, height / 1.8 * (flat - hollow)]
    ), triangles


def pear(width: float, height: float) -> Surface:
    """Return a body of revolution with a narrow upper half, that stands on a flattened base."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    narrow = 1.0 - 0.42 / (1.0 + np.exp(-7.0 * (z - 0.15)))
    scale = width / 2.0 / (narrow * np.sqrt(1.0 - z**2)).max()
    base = np.maximum(z, -0.9)
    return np.column_stack([scale * narrow * x, scale * narrow * y, height / 1.9 * base]), triangles


def egg(length: float, width: float) -> Surface:
    """Return an egg lying on its side, blunt towards -x."""
    vertices, triangles = unit_sphere()
    along, y, z = vertices.T
    taper = 1.0 - 0.14 * along
    scale = width / 2.0 / (taper * np.sqrt(1.0 - along**2)).max()
    return np.column_stack([length / 2.0 * along, scale * taper * y, scale * taper * z]), triangles


def potato(length: float, width: float, height: float) -> Surface:
    """Return an ellipsoid with smooth bumps, always the same."""
    vertices, triangles = unit_sphere()
    random = np.random.default_rng(7)
    bumps = np.zeros(len(vertices))
    for _ in range(7):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        bumps += random.uniform(-0.09, 0.12) * np.exp((vertices @ direction - 1.0) / 0.16)
    return vertices * (1.0 + bumps)[:, None] * np.array([length, width, height]) / 2.0, triangles


def bread(width: float, height: float, thickness: float, edge_radius: float) -> Surface:
    """Return a slice of a tin loaf lying flat: a rectangle with a bulging top."""
    half = width / 2.0
    top = np.linspace(-0.2 * np.pi, 1.2 * np.pi, 33)
    crown = np.column_stack([half * np.cos(top), 0.35 * height * np.sin(top)])
    outline = np.concatenate([[[-0.42 * width, -0.6 * height], [0.42 * width, -0.6 * height]], crown])
    count = len(outline)
    middle = outline.mean(axis=0)
    layers = [np.column_stack([np.vstack([outline, middle]), np.full(count + 1, z)]) for z in (0.0, thickness)]
    here, after, above = np.arange(count), (np.arange(count) + 1) % count, count + 1
    triangles = np.concatenate(
        [
            np.column_stack([here, after, after + above]),
            np.column_stack([here, after + above, here + above]),
            np.column_stack([after, here, np.full(count, count)]),
            np.column_stack([here + above, after + above, np.full(count, count + above)]),
        ]
    )
    slab = with_rounded_edges(trimesh.Trimesh(np.concatenate(layers), triangles, process=False), edge_radius)
    return np.asarray(slab.vertices), np.asarray(slab.faces)


def heart(width: float, height: float) -> Surface:
    """Return a heart-like organ lying on its back: broad base, blunt apex, a groove and two vessel stumps."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    apex = 1.0 - 0.3 * y - 0.05 * y**2
    across = width / 2.0 * x * apex / 1.15
    along = height / 2.0 * (-y) - 0.12 * width * x * (1.0 + y) / 2.0
    groove = 1.0 - 0.14 * np.exp(-(((x - 0.25 * y) / 0.22) ** 2)) * (z > 0.0) * z
    deep = 0.4 * width * z * apex * groove / 1.15
    for centre, reach in ((-0.28, 0.2), (0.26, 0.16)):
        stump = np.exp(-(((x - centre) ** 2 + (z - 0.1) ** 2) / 0.045)) * (y < 0.0)
        along = along + height * reach * stump
    # Mirrored in y, so that the triangles are turned as well.
    return np.column_stack([across, along, np.maximum(deep, -0.3 * width)]), triangles[:, ::-1]


def kidney() -> Surface:
    """Return the kidney of the demonstration."""
    return kidney_surface()


def liver(length: float, width: float, height: float) -> Surface:
    """Return a lobe of liver lying flat: thick at one end, with a thinner rim."""
    vertices, triangles = unit_sphere()
    x, y, z = vertices.T
    thick = 1.0 - 0.35 * x - 0.25 * y**2
    low = np.where(z < 0.0, 0.35, 1.0)
    wide = 1.0 - 0.18 * x + 0.1 * np.sin(2.5 * x)
    return np.column_stack([length / 2.0 * x, width / 2.0 * y * wide, height / 1.7 * z * thick * low]), triangles
