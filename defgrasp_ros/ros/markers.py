"""A picture of one grasp as markers: the deformed object coloured by stress, pads, grasp frame, forces, platform."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from defgrasp_ros.drawing.color_scales import (
    AXIS_COLORS,
    FINGER_COLOR,
    FORCE_COLOR,
    PLATFORM_COLOR,
    TEXT_COLOR,
    stress_scale,
)
from defgrasp_ros.evaluation import GraspSample, NodalFields
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.gripper_urdf import WORLD_LINK
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.ros.fields import point_message, vector_message

PAD_OPACITY, PLATFORM_OPACITY = 0.5, 0.6

FORCE_LENGTH, POINT_FORCE_LENGTH, AXIS_LENGTH = 0.5, 0.25, 0.3
"""Length of the larger finger force, of the largest contact force, and of the axes, relative to the object [-]."""
LINE_WIDTH, TEXT_HEIGHT, PLATFORM_THICKNESS, PLATFORM_MARGIN = 0.006, 0.06, 0.02, 0.2
"""Relative to the object's size [-]."""


@dataclass(frozen=True)
class GraspMarkers:
    """What the pictures of a run have in common.

    Args:
        mesh: Of the object.
        gripper: Gives the shape of the pads.
    """

    mesh: TetMesh
    gripper: Gripper

    def draw(self, sample: GraspSample, fields: NodalFields, stamp: Time) -> MarkerArray:
        """Return everything that there is to draw, in ``world``; it replaces what was drawn before."""
        markers = [
            Marker(action=Marker.DELETEALL),
            self._surface(fields),
            *self._pads(sample),
            self._grasp_frame(sample),
            *self._forces(sample),
            *self._platform(sample, fields.positions),
            self._text(sample, fields),
        ]
        for marker in markers:
            marker.header.stamp = stamp
            marker.header.frame_id = WORLD_LINK
        return MarkerArray(markers=markers)

    def _surface(self, fields: NodalFields) -> Marker:
        nodes, corners = self.mesh.surface_nodes, self.mesh.surface_triangles.ravel()
        points = _points(fields.positions[nodes])
        stress = fields.von_mises_stress[nodes]
        colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in stress_scale([stress]).to_rgba(stress).tolist()]
        places = np.searchsorted(nodes, corners).tolist()
        return Marker(
            ns="object",
            type=Marker.TRIANGLE_LIST,
            scale=_size(1.0, 1.0, 1.0),
            color=ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0),
            points=[points[i] for i in places],
            colors=[colors[i] for i in places],
        )

    def _pads(self, sample: GraspSample) -> list[Marker]:
        gripper, grasp = self.gripper, sample.grasp
        height = gripper.tip - gripper.pad_bottom
        middle = 0.5 * (gripper.tip + gripper.pad_bottom)
        markers = []
        for number, side in enumerate((1.0, -1.0)):
            place = np.array([0.0, side * (sample.opening + 0.5 * gripper.finger_thickness), middle])
            marker = Marker(
                ns="pads",
                id=number,
                type=Marker.CUBE,
                scale=_size(2.0 * gripper.finger_half_width, gripper.finger_thickness, height),
                color=_color(FINGER_COLOR, PAD_OPACITY),
            )
            marker.pose.position = point_message(grasp.position + grasp.rotation @ place)
            x, y, z, w = map(float, grasp.orientation)
            marker.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
            markers.append(marker)
        return markers

    def _grasp_frame(self, sample: GraspSample) -> Marker:
        tips = sample.grasp.position + AXIS_LENGTH * self.mesh.size * sample.grasp.rotation.T
        ends = [point for tip in tips for point in (sample.grasp.position, tip)]
        marker = self._lines("grasp_frame", ends)
        marker.colors = [color for axis in map(_color, AXIS_COLORS) for color in (axis, axis)]
        return marker

    def _forces(self, sample: GraspSample) -> list[Marker]:
        """Every contact force as a line, and the sum of each finger as an arrow from the middle of its contacts."""
        size, touching = self.mesh.size, [contact for contact in sample.contacts if contact.count]
        if not touching:
            return []
        forces = np.concatenate([contact.forces for contact in touching])
        starts = np.concatenate([contact.positions for contact in touching])
        tips = starts + POINT_FORCE_LENGTH * size / np.linalg.norm(forces, axis=1).max() * forces
        lines = self._lines("contact_forces", np.stack([starts, tips], axis=1).reshape(-1, 3))
        lines.color = _color(FORCE_COLOR)
        sums = np.array([contact.forces.sum(axis=0) for contact in touching])
        scale = FORCE_LENGTH * size / np.linalg.norm(sums, axis=1).max()
        width = LINE_WIDTH * size
        arrows = [
            Marker(
                ns="finger_forces",
                id=number,
                type=Marker.ARROW,
                scale=_size(2.0 * width, 4.0 * width, 0.0),
                color=_color(FORCE_COLOR),
                points=_points([contact.centroid, contact.centroid + scale * force]),
            )
            for number, (contact, force) in enumerate(zip(touching, sums, strict=True))
        ]
        return [lines, *arrows]

    def _platform(self, sample: GraspSample, positions: np.ndarray) -> list[Marker]:
        if not np.isfinite(sample.platform_height):
            return []
        size = self.mesh.size
        low, high = positions.min(axis=0), positions.max(axis=0)
        thickness, (x, y, _) = PLATFORM_THICKNESS * size, high - low + 2.0 * PLATFORM_MARGIN * size
        color = _color(PLATFORM_COLOR, PLATFORM_OPACITY)
        marker = Marker(ns="platform", type=Marker.CUBE, scale=_size(x, y, thickness), color=color)
        centre = 0.5 * (low + high)
        marker.pose.position = point_message([centre[0], centre[1], sample.platform_height - 0.5 * thickness])
        return [marker]

    def _text(self, sample: GraspSample, fields: NodalFields) -> Marker:
        """Which grasp this is, what happens to it, and what the colours mean."""
        size, phase = self.mesh.size, sample.phase.name.lower().replace("_", " ")
        name = sample.grasp_id or sample.grasp_index
        stress = fields.von_mises_stress[self.mesh.surface_nodes].max()
        force = sum(contact.normal_force for contact in sample.contacts)
        marker = Marker(
            ns="text",
            type=Marker.TEXT_VIEW_FACING,
            scale=_size(0.0, 0.0, TEXT_HEIGHT * size),
            color=_color(TEXT_COLOR),
            text=f"{name}: {phase}, pads {force:.3g} N, von Mises up to {stress:.3g} Pa",
        )
        top = fields.positions.max(axis=0)[2] + 2.0 * TEXT_HEIGHT * size
        marker.pose.position = point_message([*fields.positions.mean(axis=0)[:2], top])
        return marker

    def _lines(self, namespace: str, ends: Sequence[np.ndarray]) -> Marker:
        width = LINE_WIDTH * self.mesh.size
        return Marker(ns=namespace, type=Marker.LINE_LIST, scale=_size(width, 0.0, 0.0), points=_points(ends))


def _points(positions: Iterable[np.ndarray]) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in np.asarray(positions, dtype=float).tolist()]


def _size(x: float, y: float, z: float) -> Vector3:
    return vector_message((x, y, z))


def _color(color: str | np.ndarray, opacity: float = 1.0) -> ColorRGBA:
    """Return a colour of pictures as a message."""
    from matplotlib.colors import to_rgba

    r, g, b, a = map(float, to_rgba(color, opacity))
    return ColorRGBA(r=r, g=g, b=b, a=a)
