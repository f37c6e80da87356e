"""A small renderer for still pictures: orthographic, with a depth buffer, smooth shading and translucent layers.

Plotting libraries sort whole polygons by depth, which fails where a finger touches an object. Here every pixel
knows how far away it is. Needs no display and no graphics card.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array

CREASE_ANGLE = np.radians(40.0)
"""Edges sharper than this [rad] stay sharp; flatter ones are shaded as if the surface were smooth."""

LIGHT = np.array([-0.35, 0.55, 0.75])
"""Direction towards the light in the camera's frame: from the upper left, behind the viewer's shoulder."""

AMBIENT, DIFFUSE, SPECULAR, SHININESS = 0.66, 0.4, 0.12, 25.0
OCCLUSION = 0.35
"""How dark the picture gets where something near is in front of something far."""


@dataclass(frozen=True)
class Camera:
    """An orthographic view; its frame has x to the right, y up and z towards the viewer.

    Args:
        centre: Point in the middle of the picture, object frame [m], shape ``(3,)``.
        rotation: Rows are the camera's axes in the object frame, shape ``(3, 3)``.
        half_height: Half of the height that the picture shows [m].
        shape: Rows and columns of pixels.
    """

    centre: np.ndarray
    rotation: np.ndarray
    half_height: float
    shape: tuple[int, int]

    @classmethod
    def around(
        cls, points: np.ndarray, azimuth: float, elevation: float, shape: tuple[int, int], margin: float = 1.1
    ) -> Camera:
        """Return a camera that shows all points.

        Args:
            points: Object frame, z up [m], shape ``(point, 3)``.
            azimuth: Where the viewer stands, from x towards y [rad].
            elevation: How high above the horizon [rad].
            shape: Rows and columns of pixels.
            margin: Factor by which more is shown.
        """
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        rotation = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
        seen = points @ rotation.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        width, height = (high - low)[:2] / 2.0
        half_height = margin * max(height, width * shape[0] / shape[1])
        return cls(rotation.T @ ((low + high) / 2.0), rotation, half_height, shape)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the picture in the camera's frame [m]."""
        half_width = self.half_height * self.shape[1] / self.shape[0]
        return -half_width, half_width, -self.half_height, self.half_height

    def refined(self, factor: int) -> Camera:
        """Return the same view with ``factor`` times as many rows and columns of pixels."""
        return replace(self, shape=(factor * self.shape[0], factor * self.shape[1]))

    def view(self, points: np.ndarray) -> np.ndarray:
        """Return points of the object frame in the camera's frame [m]."""
        return (points - self.centre) @ self.rotation.T


@dataclass(frozen=True)
class Layer:
    """One thing as the camera sees it, without the others.

    Args:
        depth: Grows towards the viewer [m], -inf where nothing is, shape ``(row, column)``.
        color: RGB in [0, 1], shape ``(row, column, 3)``.
        opacity: In [0, 1].
    """

    depth: np.ndarray
    color: np.ndarray
    opacity: float = 1.0

    @property
    def mask(self) -> np.ndarray:
        """Where the thing is, shape ``(row, column)``."""
        return np.isfinite(self.depth)


def solid(
    camera: Camera, vertices: np.ndarray, triangles: np.ndarray, colors: np.ndarray, opacity: float = 1.0
) -> Layer:
    """Render a closed surface.

    Args:
        camera: The view.
        vertices: Object frame [m], shape ``(vertex, 3)``.
        triangles: Counter-clockwise from outside, shape ``(triangle, 3)``.
        colors: RGB of each vertex, in [0, 1], shape ``(vertex, 3)``; or of the whole, shape ``(3,)``.
        opacity: In [0, 1].
    """
    corners = camera.view(vertices)[triangles]
    normals = _corner_normals(vertices, triangles) @ camera.rotation.T
    colors = np.broadcast_to(colors, vertices.shape)[triangles]
    depth, values = _rasterize(camera, corners, np.concatenate([colors, normals], axis=-1))
    layer = Layer(depth, values[..., :3], opacity)
    layer.color[layer.mask] = _lit(layer.color[layer.mask], values[layer.mask, 3:])
    return layer


def with_outline(layer: Layer, color: np.ndarray, width: int) -> Layer:
    """Return the layer with its silhouette drawn, ``width`` pixels wide."""
    mask = layer.mask
    inner = mask.copy()
    for axis in (0, 1):
        for shift in (-width, width):
            inner &= np.roll(mask, shift, axis=axis)
    rim = mask & ~inner
    return Layer(layer.depth, np.where(rim[..., None], color, layer.color), layer.opacity)


def compose(layers: list[Layer], background: np.ndarray, softness: float) -> np.ndarray:
    """Return the picture of all layers together, RGB in [0, 1].

    Args:
        layers: In any order; each pixel is composed from back to front.
        background: RGB, shape ``(3,)`` or ``(row, column, 3)``.
        softness: Width of the shading around things in front of others [pixel].
    """
    image = _blended(layers, background)
    return np.clip(image * _occlusion(layers, softness)[..., None], 0.0, 1.0)


def compose_transparent(layers: list[Layer], softness: float) -> np.ndarray:
    """Return the picture of all layers together without a ground: RGB and opacity, shape ``(row, column, 4)``.

    Arguments as for ``compose``.
    """
    # Six channels: the same layers over black and over white; what differs shines through.
    both = _blended(layers, np.repeat([0.0, 1.0], 3))
    opacity = np.clip(1.0 - (both[..., 3:] - both[..., :3]).mean(axis=-1, keepdims=True), 0.0, 1.0)
    color = both[..., :3] / np.maximum(opacity, 1e-9) * _occlusion(layers, softness)[..., None]
    return np.concatenate([np.clip(color, 0.0, 1.0), opacity], axis=-1)


def _blended(layers: list[Layer], background: np.ndarray) -> np.ndarray:
    """Return the layers over a background of three channels, or of several times three."""
    channels = np.shape(background)[-1]
    image = np.empty((*layers[0].depth.shape, channels))
    image[:] = background
    order = np.argsort(np.stack([layer.depth for layer in layers]), axis=0)
    for rank in order:
        for index, layer in enumerate(layers):
            here = layer.mask & (rank == index)
            color = np.tile(layer.color[here], channels // 3)
            image[here] += layer.opacity * (color - image[here])
    return image


def downsample(image: np.ndarray, factor: int) -> np.ndarray:
    """Average blocks of ``factor`` x ``factor`` pixels, which smooths edges."""
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    return image.reshape(rows, factor, columns, factor, -1).mean(axis=(1, 3))


def _rasterize(camera: Camera, corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fill the triangles that face the viewer; return depth [m] and interpolated values of each pixel."""
    rows, columns = camera.shape
    left, right, bottom, top = camera.extent
    x = (corners[..., 0] - left) / (right - left) * columns - 0.5
    y = (top - corners[..., 1]) / (top - bottom) * rows - 0.5
    depth = np.full(camera.shape, -np.inf)
    picture = np.zeros((rows, columns, values.shape[-1]))
    doubled_area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    for t in np.flatnonzero(doubled_area < -1e-9):  # rows grow downwards, so what faces us turns clockwise
        x0, x1 = max(int(np.ceil(x[t].min())), 0), min(int(x[t].max()) + 1, columns)
        y0, y1 = max(int(np.ceil(y[t].min())), 0), min(int(y[t].max()) + 1, rows)
        if x0 >= x1 or y0 >= y1:
            continue
        px, py = np.arange(x0, x1), np.arange(y0, y1)[:, None]
        (ax, bx, cx), (ay, by, cy) = x[t], y[t]
        b = ((px - ax) * (cy - ay) - (cx - ax) * (py - ay)) / doubled_area[t]
        c = ((bx - ax) * (py - ay) - (px - ax) * (by - ay)) / doubled_area[t]
        weights = np.stack([1.0 - b - c, b, c], axis=-1)
        z = weights @ corners[t, :, 2]
        window = depth[y0:y1, x0:x1]
        seen = (weights.min(axis=-1) >= -1e-9) & (z > window)
        window[seen] = z[seen]
        picture[y0:y1, x0:x1][seen] = weights[seen] @ values[t]
    return depth, picture


def _corner_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the shading normal of each triangle's corners, shape ``(triangle, 3, 3)``."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    areas = np.cross(b - a, c - a)
    flat = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)
    corner_count = triangles.size
    triangle_of_corner = np.arange(corner_count) // 3
    at_vertex = coo_array(
        (np.ones(corner_count), (np.arange(corner_count), triangles.ravel())), shape=(corner_count, len(vertices))
    ).tocsr()
    one, other = (at_vertex @ at_vertex.T).nonzero()
    one_triangle, other_triangle = triangle_of_corner[one], triangle_of_corner[other]
    is_smooth = np.einsum("ij,ij->i", flat[one_triangle], flat[other_triangle]) > np.cos(CREASE_ANGLE)
    normals = np.zeros((corner_count, 3))
    np.add.at(normals, one[is_smooth], areas[other_triangle[is_smooth]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return normals.reshape(-1, 3, 3)


def _lit(color: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return colours after Blinn and Phong, with one light far away."""
    light = LIGHT / np.linalg.norm(LIGHT)
    halfway = light + [0.0, 0.0, 1.0]
    halfway /= np.linalg.norm(halfway)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    diffuse = AMBIENT + DIFFUSE * np.maximum(normal @ light, 0.0)
    specular = SPECULAR * np.maximum(normal @ halfway, 0.0) ** SHININESS
    return np.clip(color * diffuse[..., None] + specular[..., None], 0.0, 1.0)


def _occlusion(layers: list[Layer], softness: float) -> np.ndarray:
    """Return a factor that darkens what lies close behind something else (unsharp masking of the depth)."""
    opaque = np.max([layer.depth for layer in layers if layer.opacity == 1.0], axis=0)
    mask = np.isfinite(opaque)
    if not mask.any():
        return np.ones(mask.shape)
    filled = np.where(mask, opaque, 0.0)
    weight = gaussian_filter(mask.astype(float), softness)
    blurred = gaussian_filter(filled, softness) / np.maximum(weight, 1e-6)
    hidden = np.where(mask, np.maximum(blurred - opaque, 0.0), 0.0)
    scale = np.ptp(opaque[mask]) or 1.0
    return 1.0 - OCCLUSION * np.minimum(hidden / (0.08 * scale), 1.0)
