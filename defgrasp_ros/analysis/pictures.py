"""Pictures of a report as SVG: a rendered image without ground, and arrows, marks and labels as lines above it."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup, escape

from defgrasp_ros.drawing.color_scales import round_numbers
from defgrasp_ros.drawing.rendering import Camera, Layer, compose_transparent, downsample, solid
from defgrasp_ros.drawing.scene import AZIMUTH, ELEVATION, SOFTNESS, SUPERSAMPLING, Scene
from defgrasp_ros.evaluation import AccelerationResult, FingerContact

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

SHAPE = (440, 560)
"""Rows and columns of pixels of a picture."""
SMALL_SHAPE = (300, 380)
QUALITY = 88
"""Of the compression, up to 100."""
FORCE_LENGTH = 0.36
"""Of the largest contact force, in half heights of the picture."""
ARROW_LENGTH, ARROW_GAP, ARROW_RADIUS, LABEL_DISTANCE = 0.62, 0.08, 0.028, 0.13
"""Of the arrows around the object, relative to half its largest extent."""
ARROW_SIDES, RING_SIDES = 14, 8
"""Flat sides of an arrow's shaft and of a ring's section."""
RING_RADIUS, RING_WIDTH = 2.6, 0.55
"""Of the ring that marks a turn about an arrow, in radii of its shaft."""
MISSING_COLOR = np.array([0.6, 0.62, 0.65])
BODY_COLOR = np.array([0.78, 0.79, 0.81])


@dataclass
class Canvas:
    """Lines and labels above an image; places in the camera's frame [m]."""

    camera: Camera
    parts: list[str] = field(default_factory=list)

    def pixel(self, place: np.ndarray) -> np.ndarray:
        """Return columns and rows of points of the camera's frame, shape ``(..., 2)``."""
        left, right, bottom, top = self.camera.extent
        rows, columns = self.camera.shape
        place = np.asarray(place)[..., :2]
        return (place - [left, top]) / [right - left, bottom - top] * [columns, rows]

    def arrow(self, tail: np.ndarray, head: np.ndarray, css_class: str, opacity: float = 1.0) -> None:
        """Draw an arrow between points of the object frame [m]."""
        start, end = self.pixel(self.camera.view(np.stack([tail, head])))
        length = float(np.linalg.norm(end - start))
        if length < 1.0:
            return
        along = (end - start) / length
        across, size = np.array([-along[1], along[0]]), min(9.0, 0.6 * length)
        base = end - size * along
        corners = [end, base + 0.42 * size * across, base - 0.42 * size * across]
        tip = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        shaft = f"x1='{start[0]:.1f}' y1='{start[1]:.1f}' x2='{base[0]:.1f}' y2='{base[1]:.1f}'"
        self.parts.append(
            f"<g class='arrow {css_class}' opacity='{opacity:g}'><line class='rim' {shaft}/><line {shaft}/>"
            f"<polygon points='{tip}'/></g>"
        )

    def text(self, place: np.ndarray, text: str, css_class: str = "", opacity: float = 1.0) -> None:
        """Write a label in the middle of a place of the camera's frame."""
        x, y = self.pixel(place)
        self.parts.append(
            f"<text class='{css_class}' x='{x:.1f}' y='{y:.1f}' opacity='{opacity:g}'>{escape(text)}</text>"
        )

    def scale_bar(self) -> None:
        """Draw a bar of a round length in the lower left corner."""
        left, right, _, _ = self.camera.extent
        rows, columns = self.camera.shape
        length = max(round_numbers(1e-4, 0.22 * (right - left)))
        width = length / (right - left) * columns
        x, y = 12.0, rows - 10.0
        self.parts.append(
            f"<path class='scale' d='M{x:.1f},{y - 4:.1f}v4h{width:.1f}v-4'/>"
            f"<text class='scale-text' x='{x + width / 2:.1f}' y='{y - 7:.1f}'>{length * 1e3:g} mm</text>"
        )

    def svg(self, image: np.ndarray, label: str) -> Markup:
        """Return everything as one SVG element; ``label`` says in words what it shows."""
        rows, columns = self.camera.shape
        return Markup(
            f"<svg class='view' viewBox='0 0 {columns} {rows}' role='img' aria-label='{escape(label)}'>"
            f"<image width='{columns}' height='{rows}' href='{image_uri(image)}'/>{''.join(self.parts)}</svg>"
        )


def field_picture(
    scene: Scene, camera: Camera, colors: np.ndarray | None, contacts: Sequence[FingerContact], label: str
) -> Markup:
    """Return a picture of the object in colours between the fingers, with the forces of the contact points.

    Args:
        scene: What to draw.
        camera: The view.
        colors: RGB of each node, shape ``(node, 3)``; None: grey.
        contacts: Their forces on the object are drawn as arrows, pale where they are behind it.
        label: What it shows, in words.
    """
    canvas = Canvas(camera)
    forces = np.concatenate([contact.forces for contact in contacts]) if contacts else np.empty((0, 3))
    largest = np.linalg.norm(forces, axis=1).max(initial=0.0)
    if largest > 0.0:
        places = np.concatenate([contact.positions for contact in contacts])
        behind = np.concatenate([contact.normals for contact in contacts]) @ camera.rotation[2] > 0.0
        arrows = forces / largest * FORCE_LENGTH * camera.half_height
        for place, arrow, hidden in zip(places, arrows, behind, strict=True):
            canvas.arrow(place - arrow, place, "force", 0.45 if hidden else 1.0)
    canvas.scale_bar()
    return canvas.svg(_image(scene.layers(camera.refined(SUPERSAMPLING), colors), camera), label)


def turned_picture(scene: Scene, camera: Camera, colors: np.ndarray, label: str) -> Markup:
    """Return a small picture of object and fingers as they are turned, in colours."""
    canvas = Canvas(camera)
    return canvas.svg(_image(scene.layers(camera.refined(SUPERSAMPLING), colors), camera), label)


def direction_picture(
    scene: Scene, result: AccelerationResult, scale: ScalarMappable, label: str, *, about: bool
) -> Markup:
    """Return a picture of the object with an arrow for each direction, in the colour of its acceleration.

    An arrow with two heads stands for a lower bound, a grey rod for a direction without a number.

    Args:
        scene: Object and fingers.
        result: Accelerations per direction.
        scale: Their colours.
        label: What it shows, in words.
        about: Whether the acceleration is about the arrow, which then wears a ring, not along it.
    """
    positions = scene.positions
    middle, size = positions.mean(axis=0), float(np.ptp(positions, axis=0).max()) / 2.0
    tails, heads = _around(positions, middle, result.directions, ARROW_GAP * size, ARROW_LENGTH * size)
    labels = heads + LABEL_DISTANCE * size * result.directions
    camera = Camera.around(np.concatenate([scene.positions, labels]), AZIMUTH, ELEVATION, SHAPE)
    fine = camera.refined(SUPERSAMPLING)
    free = replace(scene, has_platform=False)
    layers = free.layers(fine, np.broadcast_to(BODY_COLOR, positions.shape))
    surfaces, colors = [], []
    for tail, head, loss, bound in zip(tails, heads, result.at_loss, result.is_lower_bound, strict=True):
        known = np.isfinite(loss)
        outline = _profile(float(np.linalg.norm(head - tail)), ARROW_RADIUS * size, int(known) + int(known and bound))
        surfaces.append(_revolved(outline, tail, head))
        if about:
            surfaces.append(_ring(tail, head, ARROW_RADIUS * size))
        colors += [np.array(scale.to_rgba(loss))[:3] if known else MISSING_COLOR] * (1 + about)
    layers.append(solid(fine, *_joined(surfaces, colors)))
    canvas = Canvas(camera)
    for number, (direction, label_place) in enumerate(zip(result.directions, labels, strict=True)):
        away = direction @ camera.rotation[2] < -0.2
        canvas.text(camera.view(label_place), str(number), "number", 0.5 if away else 1.0)
    return canvas.svg(_image(layers, camera), label)


def equal_cameras(scenes: Sequence[Scene], shape: tuple[int, int] = SHAPE) -> list[Camera]:
    """Return views of several scenes that show all equally large."""
    cameras = [scene.camera(shape) for scene in scenes]
    half_height = max((camera.half_height for camera in cameras), default=1.0)
    return [replace(camera, half_height=half_height) for camera in cameras]


def image_uri(image: np.ndarray) -> str:
    """Return an image with opacity, shape ``(row, column, 4)``, in [0, 1], compressed (WebP) and as text."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.round(255.0 * image).astype(np.uint8), "RGBA").save(buffer, "WEBP", quality=QUALITY)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode()


def _image(layers: list[Layer], camera: Camera) -> np.ndarray:
    return downsample(compose_transparent(layers, SOFTNESS * SUPERSAMPLING * camera.shape[0]), SUPERSAMPLING)


def _around(
    positions: np.ndarray, middle: np.ndarray, directions: np.ndarray, gap: float, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return tails and heads of arrows that point away from the object, each shape ``(direction, 3)``."""
    reach = ((positions - middle) @ directions.T).max(axis=0)[:, None] + gap
    return middle + reach * directions, middle + (reach + length) * directions


def _profile(length: float, radius: float, heads: int) -> np.ndarray:
    """Return the outline of an arrow as distance along and radius, shape ``(point, 2)``."""
    head, wide = 6.5 * radius, 2.9 * radius
    points = [(0.0, 0.0), (0.0, radius)]
    for number in range(heads):
        base = length - (heads - number) * head
        points += [(base, radius), (base, wide), (base + head, 0.0 if number == heads - 1 else radius)]
    return np.array(points if heads else [*points, (length, radius), (length, 0.0)])


def _revolved(outline: np.ndarray, tail: np.ndarray, head: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of an outline that is turned about the line from tail to head."""
    along, across, other = _axes(tail, head)
    angles = np.linspace(0.0, 2.0 * np.pi, ARROW_SIDES, endpoint=False)
    spokes = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other
    vertices = tail + outline[:, None, :1] * along + outline[:, None, 1:] * spokes
    return vertices.reshape(-1, 3), _grid(len(outline), ARROW_SIDES, closed=False)


def _ring(tail: np.ndarray, head: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of a ring around the shaft of an arrow."""
    along, across, other = _axes(tail, head)
    centre = tail + 0.3 * (head - tail)
    angles = np.linspace(0.0, 2.0 * np.pi, ARROW_SIDES, endpoint=False)
    spokes = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other
    section = np.linspace(0.0, 2.0 * np.pi, RING_SIDES, endpoint=False)[:, None, None]
    offset = RING_WIDTH * radius * (np.cos(section) * spokes - np.sin(section) * along)
    vertices = centre + RING_RADIUS * radius * spokes + offset
    return vertices.reshape(-1, 3), _grid(RING_SIDES, ARROW_SIDES, closed=True)


def _joined(
    surfaces: Sequence[tuple[np.ndarray, np.ndarray]], colors: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return several surfaces, each of one colour, as one: vertices, triangles and the colour of each vertex."""
    counts = [len(vertices) for vertices, _ in surfaces]
    offsets = np.cumsum([0, *counts[:-1]])
    triangles = [triangles + offset for (_, triangles), offset in zip(surfaces, offsets, strict=True)]
    vertices = np.concatenate([vertices for vertices, _ in surfaces])
    return vertices, np.concatenate(triangles), np.repeat(np.array(colors), counts, axis=0)


def _axes(tail: np.ndarray, head: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    along = (head - tail) / np.linalg.norm(head - tail)
    helper = np.eye(3)[np.argmin(np.abs(along))]
    across = np.cross(along, helper)
    across /= np.linalg.norm(across)
    return along, across, np.cross(along, across)


def _grid(rings: int, sides: int, *, closed: bool) -> np.ndarray:
    """Return the triangles between rings of vertices, the last joined with the first where ``closed``."""
    number = np.arange(rings * sides).reshape(rings, sides)
    first, second = (number, np.roll(number, -1, axis=0)) if closed else (number[:-1], number[1:])
    a, b, c, d = (n.ravel() for n in (first, np.roll(first, -1, 1), np.roll(second, -1, 1), second))
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
