"""The object and the pads as the kernels see them: constant arrays on the device."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import warp as wp

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.kernels_contact import Outline, Surface
from defgrasp_ros.simulation.kernels_element import element_kernels
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.types import mat43d, vec2d, vec3d

SNAP_DISTANCE = 0.1
"""How far outside the pad's outline a node still counts as inside, relative to the mean surface edge [-]."""


class DeviceModel:
    """Mesh, material and pad outline on a device; shared by all worlds."""

    def __init__(self, model: ObjectModel, gripper: Gripper, mass: scipy.sparse.csr_matrix, device: wp.Device):
        mesh = model.mesh
        self.node_count = len(mesh.vertices)
        self.tet_count = len(mesh.tetrahedra)
        self.entry_count = mesh.elements.size
        """Nodes of all elements, each counted once per element."""
        self.point_count = REFERENCE_ELEMENTS[mesh.element_order].point_count
        """Quadrature points of an element."""
        self.kernels = element_kernels(mesh.element_order)
        self.kernels.load(device)
        self.friction = model.material.friction_coefficient
        self.lame = vec2d(*model.material.lame_parameters)
        self.mean_edge = float(np.linalg.norm(np.diff(mesh.vertices[mesh.surface_edges], axis=1), axis=-1).mean())
        """Mean edge of the surface [m]."""
        self.size = mesh.size
        """Of the object [m]."""

        self.vertices = wp.array(mesh.vertices, dtype=vec3d, device=device)
        self.elements = wp.array(mesh.elements, dtype=int, device=device)
        self.gradients = wp.array(mesh.shape_gradients, dtype=mat43d, device=device)
        self.volumes = wp.array(mesh.volumes, dtype=wp.float64, device=device)
        self.mass_start = wp.array(mass.indptr, dtype=int, device=device)
        self.mass_node = wp.array(mass.indices, dtype=int, device=device)
        self.mass = wp.array(mass.data, dtype=wp.float64, device=device)
        start, entry = incidence(mesh.elements, self.node_count)
        self.incidence_start = wp.array(start, dtype=int, device=device)
        self.incidence_entry = wp.array(entry, dtype=int, device=device)
        self.incidence_tet = wp.array(entry // mesh.elements.shape[1], dtype=int, device=device)
        self.surface = _surface(model, device)
        self.outline = _outline(gripper, SNAP_DISTANCE * self.mean_edge)


def _surface(model: ObjectModel, device: wp.Device) -> Surface:
    mesh = model.mesh
    start, entry = incidence(mesh.surface_triangles, len(mesh.vertices))
    surface = Surface()
    surface.nodes = wp.array(mesh.surface_nodes, dtype=int, device=device)
    surface.triangles = wp.array(mesh.surface_triangles, dtype=int, device=device)
    surface.edges = wp.array(mesh.surface_edges, dtype=int, device=device)
    surface.incidence_start = wp.array(start, dtype=int, device=device)
    surface.incidence_triangle = wp.array(entry // 3, dtype=int, device=device)
    surface.edge_key = len(mesh.vertices)
    surface.corner_key = surface.edge_key + 4 * len(mesh.surface_edges)
    surface.body_key = surface.corner_key + 4 * len(mesh.surface_triangles)
    return surface


def _outline(gripper: Gripper, snap: float) -> Outline:
    outline = Outline()
    outline.half_width = gripper.pad_half_width
    outline.bottom = gripper.pad_bottom
    outline.top = gripper.pad_top
    outline.depth = 0.5 * gripper.finger_thickness
    outline.snap = snap
    return outline


def incidence(cells: np.ndarray, node_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where each node appears in the cells.

    Args:
        cells: Node indices of each cell, shape ``(cell, corner)``.
        node_count: Number of nodes.

    Returns:
        Start of each node's range, shape ``(node + 1,)``, and the entries of ``cells.ravel()`` that are the node, in
        ascending order, shape ``(incidence,)``.
    """
    start = np.concatenate([[0], np.cumsum(np.bincount(cells.ravel(), minlength=node_count))])
    return start, np.argsort(cells.ravel(), kind="stable")
