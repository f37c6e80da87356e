"""What a person wants to know of a mesh before it is simulated."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.object_mesh import PreparedMesh
from defgrasp_ros.mesh.quality import aspect_ratios, dihedral_angles
from defgrasp_ros.mesh.tet_mesh import TetMesh

LARGE_EXTENT = 0.4
"""Largest side of an object's bounding box [m] that raises no doubt about its unit."""

MANY_NODES = 3_000
"""Nodes above which an evaluation takes long: its matrices are dense."""

POOR_MEDIAN_ANGLE = np.radians(25.0)
"""Elements are thin throughout where half of them have a smaller angle [rad]."""


@dataclass(frozen=True, eq=False)
class MeshReport:
    """Size, mass and quality of a mesh, and what was found and mended.

    Args:
        name: Of the object.
        triangles: Triangles of the surface as given; None where there was none.
        watertight: Whether that surface was closed; None where there was none.
        components: Bodies that were given.
        nodes: Number of nodes.
        tetrahedra: Number of elements.
        element_order: 1: elements of four nodes; 2: of ten.
        extents: Sides of the bounding box [m], shape ``(3,)``.
        volume: [m^3].
        mass: [kg].
        center_of_mass: [m], shape ``(3,)``.
        inertia: About the centre of mass [kg m^2], shape ``(3, 3)``.
        min_dihedral_angle: Smallest angle between two faces of an element [rad].
        median_dihedral_angle: Median over the elements of their smallest angle [rad].
        max_aspect_ratio: Largest of the elements' aspect ratios [-]; 1: regular.
        mends: What was mended, in words.
        warnings: What may be wrong, in words.
    """

    name: str
    triangles: int | None
    watertight: bool | None
    components: int
    nodes: int
    tetrahedra: int
    element_order: int
    extents: np.ndarray
    volume: float
    mass: float
    center_of_mass: np.ndarray
    inertia: np.ndarray
    min_dihedral_angle: float
    median_dihedral_angle: float
    max_aspect_ratio: float
    mends: tuple[str, ...]
    warnings: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        values = dataclasses.asdict(self)
        return {
            name: value.tolist()
            if isinstance(value, np.ndarray)
            else list(value)
            if isinstance(value, tuple)
            else value
            for name, value in values.items()
        }

    def lines(self) -> list[str]:
        """Return everything in words."""
        sides = " x ".join(f"{1e3 * extent:.1f}" for extent in self.extents)
        principal = np.linalg.eigvalsh(self.inertia)
        lines = [f"{self.name}: {self.nodes} nodes, {self.tetrahedra} tetrahedra of order {self.element_order}"]
        if self.triangles is not None:
            closed = "watertight" if self.watertight else "not watertight"
            bodies = f", {self.components} bodies" if self.components > 1 else ""
            lines.append(f"  surface   {self.triangles} triangles, {closed}{bodies}")
        lines += [
            f"  size      {sides} mm, volume {1e6 * self.volume:.4g} cm^3",
            f"  mass      {1e3 * self.mass:.4g} g, centre of mass "
            + " ".join(f"{1e3 * value:.1f}" for value in self.center_of_mass)
            + " mm, principal inertia "
            + " ".join(f"{1e6 * value:.3g}" for value in principal)
            + " kg mm^2",
            f"  elements  dihedral angles from {np.degrees(self.min_dihedral_angle):.1f} deg, median of the smallest"
            f" {np.degrees(self.median_dihedral_angle):.0f} deg, aspect ratio up to {self.max_aspect_ratio:.1f}",
        ]
        lines += [f"  mended    {text}" for text in self.mends]
        lines += [f"  WARNING   {text}" for text in self.warnings]
        return lines


def mesh_report(name: str, prepared: PreparedMesh, material: Material) -> MeshReport:
    """Measure a mesh.

    Args:
        name: Of the object.
        prepared: The mesh, and what was found on the way to it.
        material: Its density gives mass and inertia.
    """
    mesh = prepared.mesh
    angles = dihedral_angles(mesh).min(axis=1)
    centre = mesh.node_volumes @ mesh.vertices / mesh.volume
    warnings = [*prepared.warnings, *_doubts(mesh, angles)]
    return MeshReport(
        name=name,
        triangles=prepared.triangles,
        watertight=prepared.watertight,
        components=prepared.components,
        nodes=len(mesh.vertices),
        tetrahedra=len(mesh.tetrahedra),
        element_order=mesh.element_order,
        extents=mesh.extents,
        volume=mesh.volume,
        mass=material.density * mesh.volume,
        center_of_mass=centre,
        inertia=material.density * _second_moments(mesh, centre),
        min_dihedral_angle=float(angles.min()),
        median_dihedral_angle=float(np.median(angles)),
        max_aspect_ratio=float(aspect_ratios(mesh).max()),
        mends=prepared.mends,
        warnings=tuple(warnings),
    )


def _doubts(mesh: TetMesh, angles: np.ndarray) -> list[str]:
    doubts = []
    if mesh.extents.max() > LARGE_EXTENT:
        sides = " x ".join(f"{extent:.3g}" for extent in mesh.extents)
        doubts.append(f"the object measures {sides} m, which is large for a gripper: are the units right?")
    if len(mesh.vertices) > MANY_NODES:
        doubts.append(f"{len(mesh.vertices)} nodes make an evaluation slow; a larger target_edge_length gives fewer")
    if np.median(angles) < POOR_MEDIAN_ANGLE:
        doubts.append("most elements are flat: thin walls, or a mesh made for something else; stresses are coarse")
    return doubts


def _second_moments(mesh: TetMesh, centre: np.ndarray) -> np.ndarray:
    """Return the inertia tensor about a point for density 1 [m^5], exact for linear elements."""
    corners = mesh.vertices[mesh.tetrahedra] - centre
    total = corners.sum(axis=1)
    products = np.einsum("tci,tcj->tij", corners, corners) + np.einsum("ti,tj->tij", total, total)
    covariance = np.einsum("t,tij->ij", mesh.volumes / 20.0, products)
    return np.trace(covariance) * np.eye(3) - covariance
