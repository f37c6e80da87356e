"""Bodies between pads or on the platform, as the experiments on contact use them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import SolverDivergedError
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

WORLD = np.array([0])
FAR_BELOW = -1.0
"""Height of a platform that is out of reach [m]."""
ALONG_Y = Grasp(np.zeros(3), Rotation.identity().as_quat())
"""A gripper about the origin that closes along y and approaches in z."""


def square_pads(half_width: float) -> Gripper:
    """A gripper with square pads centred at the grasp frame's origin, half their side in [m]."""
    return rectangular_pads(half_width, half_width)


def rectangular_pads(half_width: float, half_length: float) -> Gripper:
    """A gripper with pads centred at the grasp frame's origin, half their sides along x and z in [m]."""
    return Gripper(
        name="centred pads",
        pad_half_width=half_width,
        pad_bottom=-half_length,
        pad_top=half_length,
        tip=1.2 * half_length,
        finger_thickness=0.012,
        max_opening=0.05,
        max_force=100.0,
        hand_to_tcp=0.1,
        closing_speed=0.05,
    )


class Rig:
    """Some worlds of one body that are stepped together; every step must converge.

    Args:
        model: The body.
        gripper: The pads.
        device: Warp device.
        worlds: Number of worlds.
    """

    def __init__(self, model: ObjectModel, gripper: Gripper, device: str, worlds: int = 1):
        self.model = model
        self.simulator = Simulator(model, gripper, worlds, device)
        self.every = np.arange(worlds)
        self.active = self.every
        """Worlds that are stepped."""
        self.closing_force = np.zeros(worlds)
        self.height = np.full(worlds, FAR_BELOW)
        self.watch: Callable[[], None] | None = None
        """Is called after each step."""

    def put_on_platform(self) -> None:
        """Raise the platform to the body's lowest point."""
        self.height[:] = self.model.mesh.vertices[:, 2].min()
        self.simulator.place_platform(self.every, self.height[0])

    def set_gravity(self, gravity: np.ndarray) -> None:
        """Set the gravity vector of all worlds, shape ``(3,)``, or of each, ``(world, 3)`` [m/s^2]."""
        self.simulator.set_gravity(self.every, gravity)

    def place_pads(self, grasps: Sequence[Grasp], force: float, opening: float | np.ndarray) -> None:
        """Put the pads into all worlds; they do not press yet.

        Args:
            grasps: Pose of the gripper, one per world.
            force: Sum of both normal forces that they shall have [N].
            opening: Distance of each pad from the grasp's origin [m], one for all or shape ``(world,)``.
        """
        openings = np.broadcast_to(opening, len(self.every)).copy()
        self.simulator.place_gripper(self.every, list(grasps), openings, np.full(len(self.every), force))

    def branch(self, source: int, target: int) -> None:
        """Make a world the same as another one."""
        self.simulator.load(np.array([target]), [self.simulator.save(source)])
        self.closing_force[target] = self.closing_force[source]

    def squeeze(self, force: float, h: float, steps: int) -> None:
        """Raise the pads' force over the first half of some quasi-static steps."""
        start = self.closing_force.copy()
        for step in range(1, steps + 1):
            self.closing_force = start + (force - start) * min(1.0, 2.0 * step / steps)
            self.step(h, quasi_static=True)

    def step(self, h: float, steps: int = 1, *, quasi_static: bool) -> None:
        """Take some steps of length h [s] in the active worlds.

        Raises:
            SolverDivergedError: If one does not converge.
        """
        for _ in range(steps):
            force, height = self.closing_force[self.active], self.height[self.active]
            report = self.simulator.step(self.active, h, force, height, quasi_static=quasi_static)
            if not report.converged.all():
                row = int(np.argmin(report.converged))
                text = f"no solution of a step in world {self.active[row]}, residual {report.residual[row]:.2g}"
                raise SolverDivergedError(text)
            if self.watch:
                self.watch()

    def positions(self, world: int = 0) -> np.ndarray:
        """Nodes of a world [m], shape ``(node, 3)``."""
        return self.simulator.positions(np.array([world]))[0]

    def shifts(self, nodes: np.ndarray, since: np.ndarray) -> np.ndarray:
        """Mean motion of some nodes since earlier positions of all worlds [m], shape ``(world, 3)``."""
        return (self.simulator.positions(self.every)[:, nodes] - since[:, nodes]).mean(axis=1)

    def pad_forces(self) -> np.ndarray:
        """Sum of both pads' normal forces [N], shape ``(world,)``."""
        return self.simulator.normal_forces(self.every)[:, :2].sum(axis=1)

    def total_forces(self) -> np.ndarray:
        """Sum of all contact forces on the body [N], shape ``(world, 3)``."""
        return np.array([forces.forces.sum(axis=0) for forces in self.simulator.contact_forces(self.every)])

    def mean_velocity(self) -> np.ndarray:
        """Velocity of the centre of mass [m/s], shape ``(world, 3)``."""
        weights = self.model.mesh.node_volumes / self.model.mesh.volume
        return np.einsum("n,wnj->wj", weights, self.simulator.velocities(self.every))
