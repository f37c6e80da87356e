"""Rigid flat faces pressed onto a body without friction: uniaxial compression, flat punch, Hertz."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.validation.bodies import block, extrapolated, on_face
from defgrasp_ros.validation.case import Case, Experiment, absolute, relative
from defgrasp_ros.validation.rigs import ALONG_Y, WORLD, Rig, square_pads

MATERIAL = Material(2e5, 0.3, 1000.0, friction_coefficient=1e-6)
STEP = 1.0 / 200.0
PLANE_STRAIN_MODULUS = MATERIAL.youngs_modulus / (1.0 - MATERIAL.poissons_ratio**2)
LONG_STEP = 1.0 / 50.0
"""For bodies that come to rest without friction: few steps [s]."""
PUNCHED_EXTENTS = np.array([0.024, 0.018, 0.024])
"""Of the block under the punches, which are half as wide [m]."""
PUNCH_STIFFNESS = 5277.0
"""Of that block, by scikit-fem: 5592, 5433, 5381 N/m with 2, 4, 6 cells under half a punch, falling linearly [N/m]."""
RADIUS = 0.02
"""Of the sphere [m]."""
FORCES = (0.25, 0.5, 1.0, 2.0)
"""On the sphere [N]."""


def uniaxial(device: str) -> Iterator[Case]:
    """A block between pads larger than its faces."""
    width, length, force = 0.016, 0.02, 0.02
    rig = Rig(block((width, length, width), (3, 4, 3), MATERIAL), square_pads(0.010), device)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([ALONG_Y], force, length / 2)
    rig.squeeze(force, STEP, 60)
    stress = rig.simulator.stresses(WORLD)[0][0]
    strain = 0.5 * force / width**2 / MATERIAL.youngs_modulus
    source = "exact on every mesh; friction of 1e-6, residual of 1e-6 of the force at each node"
    yield relative("uniaxial compression: pressure [Pa]", -stress[:, 1, 1].mean(), 0.5 * force / width**2, 1e-4, source)
    shortening = length - 2.0 * rig.simulator.openings(WORLD)[0]
    yield relative("uniaxial compression: shortening [m]", shortening, strain * length, 1e-4, source)
    shift = rig.positions() - rig.model.mesh.vertices
    widening = shift[on_face(rig.model, 0, 1), 0].mean() - shift[on_face(rig.model, 0, -1), 0].mean()
    expected = MATERIAL.poissons_ratio * strain * width
    yield relative("uniaxial compression: widening [m]", widening, expected, 1e-3, source)


def punched_block(cells: int) -> ObjectModel:
    """A block whose cells shrink towards the punches' edges with the square of the distance.

    The displacement there grows with the root of the distance, so that linear elements keep their order.
    """
    grid = box((2.0, 2.0, 2.0), (2 * cells, 2 * cells, 2 * cells))
    from_middle = np.abs(grid.vertices)
    across = 0.5 + 0.5 * np.sign(2.0 * from_middle - 1.0) * (2.0 * from_middle - 1.0) ** 2
    deep = 1.0 - (1.0 - from_middle[:, 1]) ** 2
    place = np.sign(grid.vertices) * np.column_stack([across[:, 0], deep, across[:, 2]])
    return ObjectModel("punched block", TetMesh(0.5 * place * PUNCHED_EXTENTS, grid.tetrahedra), MATERIAL)


def punch_stiffness(cells: int, device: str) -> float:
    """Force over approach of one of two square punches on a block [N/m]."""
    force = 0.05
    rig = Rig(punched_block(cells), square_pads(PUNCHED_EXTENTS[0] / 4), device)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([ALONG_Y], force, PUNCHED_EXTENTS[1] / 2)
    rig.squeeze(force, LONG_STEP, 20)
    return float(0.5 * rig.pad_forces()[0] / (PUNCHED_EXTENTS[1] / 2 - rig.simulator.openings(WORLD)[0]))


def flat_punch(device: str) -> Iterator[Case]:
    """Two square punches against each other, extrapolated from two meshes."""
    limit = extrapolated(punch_stiffness(4, device), punch_stiffness(6, device), ratio=1.5)
    source = (
        "scikit-fem, quadratic hexahedra, extrapolated; 5 %: extrapolating 4 and 6 cells per half is 3 % above "
        "extrapolating 8 and 16"
    )
    yield relative("flat square punch: stiffness [N/m]", limit, PUNCH_STIFFNESS, 0.05, source)


def sphere(cells: int) -> ObjectModel:
    """A ball whose cells get finer towards its poles at +-y, ``cells`` along each axis of the grid it is made from."""

    def graded(x: np.ndarray) -> np.ndarray:
        return 0.3 * x + 0.7 * x**4

    grid = box((2.0, 2.0, 2.0), (cells, cells, cells))
    size = np.abs(grid.vertices)
    cube = np.sign(grid.vertices) * np.column_stack(
        [graded(size[:, 0]), 1.0 - graded(1.0 - size[:, 1]), graded(size[:, 2])]
    )
    shell = np.abs(cube).max(axis=1, keepdims=True)
    length = np.linalg.norm(cube, axis=1, keepdims=True)
    vertices = RADIUS * cube * shell / np.maximum(length, 1e-12)
    return ObjectModel("sphere", TetMesh(vertices, grid.tetrahedra), MATERIAL)


def approach(force: float) -> float:
    """How far a rigid plate comes towards the middle of a sphere between two of them [m].

    Hertz's approach less the part of the half-space beyond the sphere's middle (Tatara 1989):
    d = 3 F / (4 E* a) - F f(a) / (pi E),   f = 2 (1 + nu) R^2 / (a^2 + 4 R^2)^(3/2) + (1 - nu^2) / (a^2 + 4 R^2)^(1/2).
    """
    nu = MATERIAL.poissons_ratio
    patch = (0.75 * force * RADIUS / PLANE_STRAIN_MODULUS) ** (1.0 / 3.0)
    distance = math.hypot(patch, 2.0 * RADIUS)
    far = 2.0 * (1.0 + nu) * RADIUS**2 / distance**3 + (1.0 - nu**2) / distance
    return 0.75 * force / (PLANE_STRAIN_MODULUS * patch) - force * far / (math.pi * MATERIAL.youngs_modulus)


def pressed_sphere(cells: int, device: str) -> tuple[list[float], list[float]]:
    """Approach and contact radius of a sphere between two plates at the forces [m]."""
    model = sphere(cells)
    pole = model.mesh.vertices[:, 1].max()
    rig = Rig(model, square_pads(1.2 * RADIUS), device)
    rig.set_gravity(np.zeros(3))
    rig.place_pads([ALONG_Y], 2.0 * FORCES[-1], pole)
    approaches, radii = [], []
    for force in FORCES:
        rig.squeeze(2.0 * force, LONG_STEP, 20)
        approaches.append(float(pole - rig.simulator.openings(WORLD)[0]))
        contact = rig.simulator.contact_forces(WORLD)[0]
        pressure = np.einsum("ij,ij->i", contact.forces, contact.normals)
        # Under Hertz's pressure the mean square distance from the middle is 2/5 a^2.
        square = pressure @ (contact.positions[:, [0, 2]] ** 2).sum(axis=1) / pressure.sum()
        radii.append(math.sqrt(2.5 * square))
    return approaches, radii


def hertz_patch(device: str) -> Iterator[Case]:
    """The contact radius under the largest force."""
    _, radii = pressed_sphere(8, device)
    expected = (0.75 * FORCES[-1] * RADIUS / PLANE_STRAIN_MODULUS) ** (1.0 / 3.0)
    source = "a = (3 F R / 4 E*)^(1/3), a / R = 0.26; measured from the forces' second moment, 3 cells to the radius"
    yield relative(f"Hertz: contact radius at {FORCES[-1]:g} N [m]", radii[-1], expected, 0.05, source)


def hertz_approach(device: str) -> Iterator[Case]:
    """The approach, extrapolated from two meshes, and the exponent of the force's law."""
    coarse, fine = pressed_sphere(8, device)[0], pressed_sphere(12, device)[0]
    limits = [extrapolated(*pair, ratio=1.5) for pair in zip(coarse, fine, strict=True)]
    source = "Hertz, corrected for the sphere's other half (Tatara 1989); 3 %: the contact's rim moves by single nodes"
    for force, limit in zip(FORCES, limits, strict=True):
        yield relative(f"Hertz: approach at {force:g} N [m]", limit, approach(force), 0.03, source)
    span = math.log(FORCES[-1] / FORCES[0])
    exponent = span / math.log(limits[-1] / limits[0])
    expected = span / math.log(approach(FORCES[-1]) / approach(FORCES[0]))
    source = "3/2 for a half-space, corrected as above; 0.07: errors of 3 % at both ends"
    yield absolute("Hertz: exponent of force over approach", exponent, expected, 0.07, source)


EXPERIMENTS = (
    Experiment("uniaxial compression", uniaxial),
    Experiment("flat punch", flat_punch, quick=False),
    Experiment("Hertz, contact radius", hertz_patch),
    Experiment("Hertz, approach", hertz_approach, quick=False),
)
