"""Objects and grasps of the benchmark, made by formulae so that they are the same everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from defgrasp_ros.experiments.settling import settle
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.mesh_files import read_mesh
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.stepper import StepReport

TIME_STEP = 0.005
"""The protocol's default [s]."""
SQUEEZE_TIME = 0.2
"""Ramp of the closing force [s], as in the protocol."""
HOLD_TIME = 0.1
"""Time for which the platform sinks and the motion is dynamic [s]."""
PLATFORM_ACCELERATION = 0.1
"""With which the platform leaves, as in the protocol [m/s^2]."""
SAFETY_FACTOR = 1.3
"""Target force relative to m g / mu [-], as in the protocol."""
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
"""Orientation of a hand that points down and closes along y."""

HAND = Gripper(
    name="Franka hand without palm",
    pad_half_width=0.0085,
    pad_bottom=-0.0450,
    pad_top=0.0040,
    side_fillet=0.0020,
    tip_fillet=0.0050,
    tip=0.0090,
    finger_thickness=0.0120,
    max_opening=0.044442,
    max_force=140.0,
    hand_to_tcp=0.1034,
    closing_speed=0.05,
)
"""The pads of ``config/grippers/franka_hand.yaml``, which cannot be read without PyYAML."""


def block() -> TetMesh:
    """60 x 40 x 40 mm, 490 nodes."""
    return box((0.06, 0.04, 0.04), (9, 6, 6))


def rectangle() -> TetMesh:
    """60 x 30 x 20 mm with fillets of 2 mm, 364 nodes."""
    extents, fillet = np.array([0.06, 0.03, 0.02]), 0.002
    mesh = box(extents, (12, 6, 3))
    core = np.clip(mesh.vertices, fillet - extents / 2, extents / 2 - fillet)
    return TetMesh(core + _rounded(mesh.vertices - core, 1.0), mesh.tetrahedra)


def banana() -> TetMesh:
    """180 mm long, 36 mm thick, tapered and bent in the plane of the platform, 425 nodes."""
    mesh = box((2.0, 2.0, 2.0), (16, 4, 4))
    along = mesh.vertices[:, 0]
    section = 0.018 * (1.0 - 0.5 * along**2)[:, None] * _rounded(mesh.vertices[:, 1:], 0.7)
    angle, bend = 0.9 * along, 0.1
    radius = bend + section[:, 0]
    return TetMesh(
        np.column_stack([radius * np.sin(angle), radius * np.cos(angle) - bend, section[:, 1]]), mesh.tetrahedra
    )


def apple() -> TetMesh:
    """A rounded cube of 70 mm, 2366 nodes."""
    mesh = box((2.0, 2.0, 2.0), (12, 12, 13))
    return TetMesh(0.035 * _rounded(mesh.vertices, 0.7), mesh.tetrahedra)


def _rounded(points: np.ndarray, roundness: float) -> np.ndarray:
    """Move points of cubes about the origin towards spheres through the middles of the faces, all the way at 1."""
    largest = np.abs(points).max(axis=1, keepdims=True)
    length = np.linalg.norm(points, axis=1, keepdims=True)
    ratio = np.divide(largest, length, out=np.ones_like(length), where=length > 0.0)
    return points * (1.0 - roundness + roundness * ratio)


SHAPES: dict[str, Callable[[], TetMesh]] = {"block": block, "rectangle": rectangle, "banana": banana, "apple": apple}


def mesh_of(scene: str) -> TetMesh:
    """Return the mesh of a scene: one of ``SHAPES``, or that of a file."""
    return SHAPES[scene]() if scene in SHAPES else read_mesh(Path(scene))


def grasps_of(mesh: TetMesh, count: int) -> list[Grasp]:
    """Return different grasps from above near the middle of the object, the first exactly there."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    # The slice of the object over its middle, where the hand is; a banana's is not where its box's middle is.
    near = mesh.vertices[np.abs(mesh.vertices[:, 0] - middle[0]) < 0.1 * np.ptp(mesh.vertices[:, 0])]
    middle[1] = (near[:, 1].min() + near[:, 1].max()) / 2
    # Multiples of two irrational numbers fill the square evenly (Roberts' sequence).
    share = (0.5 + np.outer(np.arange(count), [0.7548776662, 0.5698402910])) % 1.0 - 0.5
    offset = share * [0.15 * np.ptp(mesh.vertices[:, 0]), 0.3 * np.ptp(mesh.vertices[:, 2])]
    return [Grasp(middle + [along, 0.0, up], FROM_ABOVE) for along, up in offset]


class Squeeze:
    """All worlds of a simulator, each with another grasp, from first touch through the force ramp to a short hold."""

    def __init__(self, model: ObjectModel, world_count: int, device: str):
        self.simulator = Simulator(model, HAND, world_count, device)
        self.worlds = np.arange(world_count)
        settled = settle(self.simulator, 0, TIME_STEP)
        self.simulator.load(self.worlds, [settled.snapshot] * world_count)
        grasps = [settled.follow(grasp) for grasp in grasps_of(model.mesh, world_count)]
        self.force = np.full(world_count, model.default_target_force(SAFETY_FACTOR))
        self.height = settled.platform_height
        opening = np.full(world_count, HAND.max_opening)
        self.simulator.place_gripper(self.worlds, grasps, opening, self.force)
        opening -= self.simulator.pad_gaps(self.worlds).min(axis=1)
        self.simulator.place_gripper(self.worlds, grasps, opening, self.force)

    def run(self) -> list[StepReport]:
        """Step through it; worlds that fail stay where they are and try again, as their neighbours go on."""
        squeeze, hold = round(SQUEEZE_TIME / TIME_STEP), round(HOLD_TIME / TIME_STEP)
        height, speed, reports = self.height, 0.0, []
        for count in range(1, squeeze + hold + 1):
            closing = min(1.0, count / squeeze) * self.force
            if count > squeeze:
                speed += PLATFORM_ACCELERATION * TIME_STEP
                height -= speed * TIME_STEP
            heights = np.full(len(self.worlds), height)
            quasi_static = count <= squeeze
            reports.append(self.simulator.step(self.worlds, TIME_STEP, closing, heights, quasi_static=quasi_static))
        return reports
