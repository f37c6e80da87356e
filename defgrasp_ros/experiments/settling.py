"""The object comes to rest on the platform: the state before the gripper touches it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import CanceledError, SolverDivergedError
from defgrasp_ros.evaluation import NAN, DeformedState
from defgrasp_ros.experiments.metrics import deformation, rigid_motion, von_mises_stress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.simulation.shard import WorldSnapshot
from defgrasp_ros.simulation.simulator import Simulator

SETTLE_STEPS = 80
"""Largest number of steps for the object to settle on the platform."""
SETTLED_CHANGE = 1e-6
"""Change of shape in a step, relative to the object's size, at which it counts as settled [-]."""


@dataclass(frozen=True, eq=False)
class SettledObject:
    """The object at rest on the platform, and how it got there as a rigid body."""

    state: DeformedState
    """Pre-contact state."""
    platform_height: float
    """Surface of the platform [m]."""
    rotation: np.ndarray
    """Of the rigid motion from the mesh as given to the settled object, shape ``(3, 3)``."""
    translation: np.ndarray
    """[m], shape ``(3,)``."""
    duration: float
    """Simulated time [s]."""
    snapshot: WorldSnapshot
    """The world of the settled object, without a gripper."""

    def follow(self, grasp: Grasp) -> Grasp:
        """Return the grasp at the same place of the settled object."""
        orientation = Rotation.from_matrix(self.rotation @ grasp.rotation).as_quat()
        return replace(grasp, position=self.rotation @ grasp.position + self.translation, orientation=orientation)


def settle(
    simulator: Simulator, world: int, step_length: float, should_stop: Callable[[], bool] = lambda: False
) -> SettledObject:
    """Put a platform at the object's lowest point, and let the object sag on it.

    The steps are quasi-static, so that an object that would roll away hardly begins to.

    Args:
        simulator: Its worlds hold the object as given.
        world: The world in which it settles.
        step_length: [s].
        should_stop: Whether to give up now.

    Raises:
        CanceledError: If it should stop.
        SolverDivergedError: If a step has no solution.
    """
    mesh, here = simulator.model.mesh, np.array([world])
    height = float(mesh.vertices[:, 2].min())
    simulator.place_platform(here, height)
    shape = mesh.vertices
    for count in range(1, SETTLE_STEPS + 1):
        if should_stop():
            raise CanceledError("ended before the object had come to rest")
        report = simulator.step(here, step_length, np.zeros(1), np.array([height]), quasi_static=True)
        if not report.converged.all():
            raise SolverDivergedError(
                f"the object does not settle on the platform: residual {report.residual[0]:.2g} of its weight "
                f"in step {count}; look for slivers in the mesh, or mesh it again"
            )
        if report.crushed.any():
            raise SolverDivergedError(
                f"the object collapses under its own weight: elements turn inside out in step {count} of settling; "
                f"youngs_modulus = {simulator.model.material.youngs_modulus:g} Pa is too small for its size and density"
            )
        last, shape = shape, simulator.positions(here)[0]
        if deformation(last, shape, mesh.node_volumes).max() < SETTLED_CHANGE * mesh.size:
            break
    rotation, translation = rigid_motion(mesh.vertices, shape, mesh.node_volumes)
    state = replace(deformed_state(simulator, world), opening=NAN)
    return SettledObject(state, height, rotation, translation, count * step_length, simulator.save(world))


def deformed_state(simulator: Simulator, world: int) -> DeformedState:
    """Return the present fields of one world."""
    here = np.array([world])
    stress, _ = simulator.point_stresses(here)
    return DeformedState(
        simulator.positions(here)[0].copy(),
        von_mises_stress(stress[0]).max(axis=1),
        float(simulator.openings(here)[0]),
    )
