"""What changes from world to world and from step to step: motion, gripper and platform."""

from __future__ import annotations

import numpy as np
import warp as wp

from defgrasp_ros.object_model import STANDARD_GRAVITY
from defgrasp_ros.simulation.kernels_elasticity import Spin
from defgrasp_ros.simulation.kernels_faces import BODY_COUNT, PLATFORM, Bodies
from defgrasp_ros.simulation.types import mat33d, vec3d

UPWARD_FRAME = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Frame of the platform: rows normal, and two directions along it."""


class WorldState:
    """State arrays; the first axis is the world. Vectors are in the object frame."""

    def __init__(self, world_count: int, node_count: int, device: wp.Device):
        def zeros(shape, dtype) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=device)

        nodal = (world_count, node_count)
        self.displacement = zeros(nodal, vec3d)
        """Iterate of the running step [m]."""
        self.start_displacement = zeros(nodal, vec3d)
        """u_n [m]."""
        self.start_velocity = zeros(nodal, vec3d)
        """v_n [m/s]."""
        self.trend = zeros(nodal, vec3d)
        """Rate at which the last step moved the nodes [m/s]; unlike the velocity not forgotten when quasi-static."""
        self.rotation = zeros(nodal, mat33d)
        """Nodal rotations that turn the shared inverse."""
        self.rotation.fill_(mat33d(np.eye(3)))
        self.gravity = zeros(world_count, vec3d)
        """[m/s^2]."""
        self.gravity.fill_(vec3d(0.0, 0.0, -STANDARD_GRAVITY))

        self.spin = Spin()
        self.spin.centre, self.spin.velocity, self.spin.acceleration = (zeros(world_count, vec3d) for _ in range(3))

        self.finger_damping = wp.ones(world_count, dtype=wp.float64, device=device)
        """c [N s/m]."""
        self.closing_force = zeros(world_count, wp.float64)
        """F [N]."""
        self.start_opening = zeros(world_count, wp.float64)
        """q_n [m]."""
        self.bodies = Bodies()
        self.bodies.enabled = zeros((world_count, BODY_COUNT), int)
        self.bodies.frame = zeros((world_count, BODY_COUNT), mat33d)
        self.bodies.base = zeros((world_count, BODY_COUNT), wp.float64)
        self.bodies.origin = zeros(world_count, vec3d)
        self.bodies.opening = zeros(world_count, wp.float64)
        self.bodies.start_opening = self.start_opening
        self.bodies.frame.assign(np.tile(UPWARD_FRAME, (world_count, BODY_COUNT, 1, 1)))

    @property
    def motion(self) -> tuple[wp.array, ...]:
        """The arrays that say where a world is at the start of a step."""
        return self.start_displacement, self.start_velocity, self.trend, self.start_opening

    def snapshot(self, world: int) -> list[np.ndarray]:
        """Return what is known about a world, on the host."""
        return [array.numpy()[world].copy() for array in self._arrays]

    def restore(self, world: int, snapshot: list[np.ndarray]) -> None:
        """Give a world what was known about another."""
        for array, values in zip(self._arrays, snapshot, strict=True):
            set_entries(array, world, values)

    @property
    def _arrays(self) -> list[wp.array]:
        nodal = [self.displacement, self.start_displacement, self.start_velocity, self.trend, self.rotation]
        hand = [self.finger_damping, self.closing_force, self.start_opening]
        bodies = [self.bodies.enabled, self.bodies.frame, self.bodies.base, self.bodies.origin, self.bodies.opening]
        spin = [self.spin.centre, self.spin.velocity, self.spin.acceleration]
        return [*nodal, self.gravity, *spin, *hand, *bodies]

    def platform_heights(self, worlds: np.ndarray) -> np.ndarray:
        """Height of the platform's surface [m], shape ``(n,)``."""
        return self.bodies.base.numpy()[worlds, PLATFORM].copy()


def set_entries(array: wp.array, index, values) -> None:
    """Set some entries of a device array from the host: array[index] = values."""
    host = array.numpy()
    host[index] = values
    if array.device.is_cuda:
        array.assign(host)
