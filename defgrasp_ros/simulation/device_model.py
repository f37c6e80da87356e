"""The object and the pads as the kernels see them: constant arrays on the device."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import warp as wp

from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.kernels_detection import EDGE_POINTS, TRIANGLE_POINTS, Surface
from defgrasp_ros.simulation.kernels_element import element_kernels
from defgrasp_ros.simulation.kernels_faces import Faces
from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.types import mat43d, vec2d, vec3d

UNBOUNDED = 1e3
"""Half the width of the platform, and its depth [m]: further than anything gets."""


class DeviceModel:
    """Mesh, material and shape of the bodies on a device; shared by all worlds."""

    def __init__(self, model: ObjectModel, gripper: Gripper, mass: scipy.sparse.csr_matrix, device: wp.Device):
        mesh = model.mesh
        self.node_count = len(mesh.vertices)
        self.tet_count = len(mesh.tetrahedra)
        self.entry_count = mesh.elements.size
        """Nodes of all elements, each counted once per element."""
        self.point_count = REFERENCE_ELEMENTS[mesh.element_order].point_count
        """Quadrature points of an element."""
        self.kernels = element_kernels(mesh.element_order)
        self.friction = model.material.friction_coefficient
        self.lame = vec2d(*model.material.lame_parameters)
        self.mean_edge = float(np.linalg.norm(np.diff(mesh.vertices[mesh.surface_edges], axis=1), axis=-1).mean())
        """Mean edge of the surface [m]."""
        self.size = mesh.size
        """Of the object [m]."""
        self.volume = float(mesh.volumes.sum())
        """Of the object [m^3]."""

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
        self.faces = _faces(gripper, device)


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
    surface.triangle_key = surface.edge_key + int(EDGE_POINTS) * len(mesh.surface_edges)
    surface.body_key = surface.triangle_key + int(TRIANGLE_POINTS) * len(mesh.surface_triangles)
    return surface


def _faces(gripper: Gripper, device: wp.Device) -> Faces:
    """Return the faces of both pads, the platform and the palm, in the order of their numbers."""
    sharp, half, palm = (0.0, 0.0), gripper.pad_half_width, gripper.palm
    pad_low, pad_high = (-half, gripper.pad_bottom), (half, gripper.pad_top)
    pad_fillet_low, pad_fillet_high = (gripper.side_fillet, 0.0), (gripper.side_fillet, gripper.tip_fillet)
    pad_depth = 0.5 * gripper.finger_thickness
    platform = (UNBOUNDED, UNBOUNDED)
    palm_corner = (palm.half_width, palm.half_length) if palm else sharp
    palm_depth = palm.face + gripper.hand_to_tcp if palm else 0.0

    def mirrored(corner: tuple[float, float]) -> tuple[float, float]:
        return -corner[0], -corner[1]

    def vectors(*rows: tuple[float, float]) -> wp.array:
        return wp.array(rows, dtype=vec2d, device=device)

    faces = Faces()
    faces.low = vectors(pad_low, pad_low, mirrored(platform), mirrored(palm_corner))
    faces.high = vectors(pad_high, pad_high, platform, palm_corner)
    faces.fillet_low = vectors(pad_fillet_low, pad_fillet_low, sharp, sharp)
    faces.fillet_high = vectors(pad_fillet_high, pad_fillet_high, sharp, sharp)
    faces.depth = wp.array([pad_depth, pad_depth, UNBOUNDED, palm_depth], dtype=wp.float64, device=device)
    return faces


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
