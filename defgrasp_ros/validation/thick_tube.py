"""A thick tube under inner pressure in plane strain, against Lame's solution."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.validation.bodies import extrapolated
from defgrasp_ros.validation.case import Case, Experiment, relative
from defgrasp_ros.validation.statics import ClampedBody

INNER, OUTER, SLICE = 0.01, 0.02, 0.0025
PRESSURE = 10.0
"""Small enough for linear elasticity: strains of 1e-4 [Pa]."""


def widening(cells: int, material: Material, device: str) -> float:
    """Mean radial displacement of the inner face of a quarter tube, ``cells`` through the wall [m]."""
    grid = box((1.0, 1.0, 1.0), (cells, 2 * cells, max(1, cells // 4)))
    along, turn, height = (grid.vertices + 0.5).T
    radius, angle = INNER + (OUTER - INNER) * along, 0.5 * np.pi * turn
    vertices = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), SLICE * height])
    model = ObjectModel("tube", TetMesh(vertices, grid.tetrahedra), material)
    symmetry = np.column_stack([turn > 1.0 - 1e-9, turn < 1e-9, np.ones_like(turn, dtype=bool)])
    load = np.zeros_like(vertices)
    for triangle in model.mesh.surface_triangles:
        if (along[triangle] < 1e-9).all():
            a, b, c = vertices[triangle]
            load[triangle] -= PRESSURE * np.cross(b - a, c - a) / 6.0
    displacement = ClampedBody(model, symmetry, device).balance(load)
    inside = along < 1e-9
    return float(np.einsum("ij,ij->i", displacement[inside], vertices[inside]).mean() / INNER)


def tube(device: str) -> Iterator[Case]:
    """Widening of the bore, extrapolated from 4 and 8 cells through the wall."""
    material = Material(2e5, 0.3)
    nu, a, b = material.poissons_ratio, INNER, OUTER
    factor = PRESSURE * a**2 * (1.0 + nu) / (material.youngs_modulus * (b**2 - a**2))
    expected = factor * ((1.0 - 2.0 * nu) * a + b**2 / a)
    limit = extrapolated(*(widening(cells, material, device) for cells in (4, 8)))
    source = "Lame, plane strain; extrapolated from 4 and 8 cells; 1 %: terms above h^2"
    yield relative("thick tube under pressure: widening of the bore [m]", limit, expected, 0.01, source)


EXPERIMENTS = (Experiment("thick tube", tube),)
