"""What a picture of a grasp shows: object, fingers and platform at one instant, as layers for the renderer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from defgrasp_ros.drawing.color_scales import FINGER_COLOR, PLATFORM_COLOR
from defgrasp_ros.drawing.rendering import Camera, Layer, solid, with_outline
from defgrasp_ros.evaluation import DeformedState, GraspEvaluation
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel

STAGES = {"post_pickup": "after the hold", "at_target_force": "at the target force"}
"""Stages that can be drawn, the first one that there is, and what they are called."""

PLATFORM_STAGE = "at_target_force"
"""The stage in which the object still touches the platform."""

AZIMUTH, ELEVATION = math.radians(-50.0), math.radians(22.0)
SUPERSAMPLING = 2
"""Pixels that are rendered for one of the picture, along each side."""
SOFTNESS = 0.012
"""Width of the shading around things in front of others, relative to the height of the picture."""

FINGER_OUTLINE, FINGER_OPACITY = np.array([0.15, 0.2, 0.3]), 0.42
IDLE_COLOR, IDLE_FINGER_OPACITY = np.array([0.82, 0.82, 0.82]), 0.25
PLATFORM_THICKNESS, PLATFORM_MARGIN = 0.003, 0.012
FILLET_POINTS = 6
"""Points across a rounded edge."""

BOX_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
BOX_TRIANGLES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)


@dataclass(frozen=True)
class Scene:
    """One object between two fingers.

    Args:
        object_model: The object.
        gripper: Gives the shape of the fingers.
        grasp: The pose.
        state: Shape and stress; None: the object is undeformed and the gripper open, both drawn grey.
        has_platform: Whether the object still lies on the platform.
        turn: Rotation matrix by which object and hand are turned about the object's middle, shape ``(3, 3)``.
    """

    object_model: ObjectModel
    gripper: Gripper
    grasp: Grasp
    state: DeformedState | None
    has_platform: bool = False
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    @classmethod
    def of_evaluation(
        cls, object_model: ObjectModel, gripper: Gripper, grasp: Grasp, evaluation: GraspEvaluation
    ) -> Scene:
        """Return the scene after the hold, or at the target force where there is no hold, or before the grasp."""
        stage = drawn_stage(evaluation)
        state = evaluation.fields[stage] if stage else None
        return cls(object_model, gripper, grasp, state, has_platform=stage in (None, PLATFORM_STAGE))

    @property
    def positions(self) -> np.ndarray:
        """Nodes [m], shape ``(node, 3)``."""
        return self.turned(self._positions)

    @property
    def nodal_stress(self) -> np.ndarray:
        """Von Mises stress [Pa], mean of the adjacent elements weighted by volume, shape ``(node,)``."""
        return self.object_model.mesh.nodal_mean(self.state.von_mises_stress)

    @property
    def fingers(self) -> list[np.ndarray]:
        """Vertices of the two fingers [m], each of shape ``(vertex, 3)``."""
        opening = self.state.opening if self.state else self.gripper.max_opening
        shape, _ = finger_surface(self.gripper)
        placed = [(shape + [0.0, opening, 0.0]) * [1.0, side, 1.0] for side in (1.0, -1.0)]
        return [self.turned(self.grasp.position + vertices @ self.grasp.rotation.T) for vertices in placed]

    @property
    def platform(self) -> np.ndarray | None:
        """Corners of the platform [m], shape ``(8, 3)``; None once it has gone."""
        if not self.has_platform:
            return None
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        low[:2] -= PLATFORM_MARGIN
        high[:2] += PLATFORM_MARGIN
        low[2], high[2] = low[2] - PLATFORM_THICKNESS, low[2]
        return low + BOX_CORNERS * (high - low)

    @property
    def outline(self) -> np.ndarray:
        """Points that a picture must show [m], shape ``(point, 3)``."""
        return np.concatenate([self.positions, *self.fingers, *([] if self.platform is None else [self.platform])])

    def camera(self, shape: tuple[int, int]) -> Camera:
        """Return a view of everything, with so many rows and columns of pixels."""
        return Camera.around(self.outline, AZIMUTH, ELEVATION, shape)

    def layers(self, camera: Camera, colors: np.ndarray | None = None) -> list[Layer]:
        """Return object, fingers and platform as the camera sees them.

        Args:
            camera: The view.
            colors: RGB of each node, shape ``(node, 3)``; None: grey.
        """
        held = self.state is not None
        colors = IDLE_COLOR if colors is None else colors
        layers = [solid(camera, self.positions, self.object_model.mesh.surface_triangles, colors)]
        for vertices, flip in zip(self.fingers, (1, -1), strict=True):
            _, triangles = finger_surface(self.gripper)
            opacity = FINGER_OPACITY if held else IDLE_FINGER_OPACITY
            finger = solid(camera, vertices, triangles[:, ::flip], FINGER_COLOR if held else IDLE_COLOR, opacity)
            layers.append(with_outline(finger, FINGER_OUTLINE, SUPERSAMPLING))
        if self.platform is not None:
            layers.append(solid(camera, self.platform, BOX_TRIANGLES, PLATFORM_COLOR))
        return layers

    def turned(self, points: np.ndarray) -> np.ndarray:
        """Return points that move with object and hand where the scene shows them [m]."""
        middle = self._positions.mean(axis=0)
        return middle + (points - middle) @ self.turn.T

    @property
    def _positions(self) -> np.ndarray:
        return self.object_model.mesh.vertices if self.state is None else self.state.positions


def drawn_stage(evaluation: GraspEvaluation) -> str | None:
    """Return the stage that shows an evaluation best; None if it has no fields over the mesh."""
    return next((stage for stage in STAGES if stage in evaluation.fields), None)


def finger_surface(gripper: Gripper) -> tuple[np.ndarray, np.ndarray]:
    """Return the left finger with its pad face in the plane y = 0 and rounded edges.

    Returns:
        Vertices in the grasp frame [m], shape ``(vertex, 3)``, and triangles, counter-clockwise from outside.
    """
    arc = np.sin(np.linspace(0.0, np.pi / 2.0, FILLET_POINTS))
    side = gripper.pad_half_width + gripper.side_fillet * arc
    tip = gripper.pad_top + gripper.tip_fillet * arc
    across = _distinct(-side, side)
    along = _distinct([gripper.pad_bottom, gripper.tip], tip)
    x, z = np.meshgrid(across, along, indexing="ij")
    layers = [gripper.pad_drop(x, z), np.full_like(x, gripper.finger_thickness)]
    vertices = np.concatenate([np.column_stack([x.ravel(), y.ravel(), z.ravel()]) for y in layers])
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    face = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    following, back = np.roll(rim, -1), x.size
    wall = [[rim, rim + back, following + back], [rim, following + back, following]]
    return vertices, np.concatenate([face, face[:, ::-1] + back, *(np.column_stack(half) for half in wall)])


def _distinct(*coordinates: Sequence[float]) -> np.ndarray:
    """Return coordinates in ascending order, those once that differ by rounding only [m]."""
    return np.unique(np.round(np.concatenate(coordinates), 12))
