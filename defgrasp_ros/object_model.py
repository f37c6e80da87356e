"""The object to be grasped: its tetrahedra and its material."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from defgrasp_ros.material import Material
from defgrasp_ros.mesh.tet_mesh import TetMesh

STANDARD_GRAVITY = 9.81
"""Gravity of the protocol [m/s^2], along -z of the object frame (the paper's value)."""


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A deformable object at rest in its frame, z up."""

    name: str
    mesh: TetMesh
    material: Material

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.material.density * self.mesh.volume

    @property
    def weight(self) -> float:
        """m g [N]."""
        return self.mass * STANDARD_GRAVITY

    @cached_property
    def centroid(self) -> np.ndarray:
        """Centre of mass at rest [m], shape ``(3,)``."""
        return self.mesh.node_volumes @ self.mesh.vertices / self.mesh.volume

    def default_target_force(self, safety_factor: float) -> float:
        """F_p = safety factor x m g / mu [N], the SUM of both pad normal forces (paper, section IV)."""
        return safety_factor * self.weight / self.material.friction_coefficient
