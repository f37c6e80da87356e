"""Edge lengths that give a number of nodes: what a simulation costs is a matter of nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from defgrasp_ros.errors import MeshingTimeoutError, TetrahedralizationError
from defgrasp_ros.mesh.tet_mesh import TetMesh

DEFAULT_NODES, TOLERANCE = 1_000, 0.15
"""Nodes aimed at where no edge length is asked for, and the relative difference that is let be."""

ATTEMPTS = 4
"""How many edge lengths are tried."""

GROWTH = 0.4
"""The edge length goes with this power of the number of nodes: 1/3 for many, 1/2 where all are at the surface."""


def with_nodes(
    make: Callable[[float], TetMesh],
    edge_length: float,
    element_order: int,
    after_failure: float,
    nodes: int = DEFAULT_NODES,
    tolerance: float = TOLERANCE,
    attempts: int = ATTEMPTS,
) -> TetMesh:
    """Make meshes until one has about so many nodes, or takes too long; return the one that comes nearest.

    Args:
        make: Makes the mesh of an edge length [m].
        edge_length: With which to begin [m].
        element_order: Of the elements that the mesh is for.
        after_failure: Factor on an edge length with which ``make`` raises ``TetrahedralizationError``.
        nodes: How many there should be.
        tolerance: Relative difference that is let be.
        attempts: How many edge lengths are tried.

    Raises:
        TetrahedralizationError: If there is no mesh of any of the edge lengths: what was wrong with the first.
        InvalidMeshError: Whatever else ``make`` raises, at once.
    """
    best, excess = None, np.inf
    failure: TetrahedralizationError | None = None
    for _ in range(attempts):
        try:
            mesh = make(edge_length)
        except TetrahedralizationError as error:
            failure = failure or error
            if isinstance(error, MeshingTimeoutError):
                break
            edge_length *= after_failure
            continue
        share = len(replace(mesh, element_order=element_order).vertices) / nodes
        if abs(np.log(share)) < excess:
            best, excess = mesh, abs(np.log(share))
        if excess < tolerance:
            break
        edge_length *= share**GROWTH
    if best is None:
        raise failure
    return best
