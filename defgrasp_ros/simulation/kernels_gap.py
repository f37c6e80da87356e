"""Where the gap to a body is smallest over an edge or a triangle of the surface; see ``kernels_detection``."""

import warp as wp

from defgrasp_ros.simulation.kernels_faces import RIM, Faces, drop, outline_high, outline_low
from defgrasp_ros.simulation.types import vec2d, vec3d

wp.set_module_options({"enable_backward": False})

BISECTIONS = wp.constant(50)
"""Halvings in the search for the smallest gap along an edge: to rounding."""


# --- the point of an edge with the smallest gap ----------------------------------------------------------------------


@wp.func
def clip(a: vec3d, b: vec3d, low: vec2d, high: vec2d) -> vec2d:
    """Return the range of fractions of the segment a-b within a rectangle; its end is below its start if none is."""
    start = wp.float64(0.0)
    end = wp.float64(1.0)
    for k in range(2):
        d = b[k] - a[k]
        if d == wp.float64(0.0):
            if a[k] < low[k] or a[k] > high[k]:
                return vec2d(wp.float64(1.0), wp.float64(0.0))
        else:
            first = (low[k] - a[k]) / d
            second = (high[k] - a[k]) / d
            start = wp.max(start, wp.min(first, second))
            end = wp.min(end, wp.max(first, second))
    return vec2d(start, end)


@wp.func
def gap_slope(faces: Faces, body: int, a: vec3d, b: vec3d, f: wp.float64) -> wp.float64:
    """Derivative of the gap with the fraction f of the segment a-b [m]."""
    d = b - a
    p = a + f * d
    h = drop(faces, body, vec2d(p[0], p[1]))
    return d[2] + h[1] * d[0] + h[2] * d[1]


@wp.func
def smallest_gap(faces: Faces, body: int, a: vec3d, b: vec3d, start: wp.float64, end: wp.float64) -> wp.float64:
    """Return the fraction of the segment a-b, from start to end, where the gap is smallest."""
    low = start
    high = end
    if gap_slope(faces, body, a, b, low) >= wp.float64(0.0):
        return low
    if gap_slope(faces, body, a, b, high) <= wp.float64(0.0):
        return high
    for _ in range(BISECTIONS):
        middle = wp.float64(0.5) * (low + high)
        if gap_slope(faces, body, a, b, middle) < wp.float64(0.0):
            low = middle
        else:
            high = middle
    return wp.float64(0.5) * (low + high)


@wp.func
def edge_point(faces: Faces, body: int, a: vec3d, b: vec3d, which: int) -> wp.float64:
    """Return the fraction of the edge a-b at its first or second point, or -1 where it has none inside."""
    none = wp.float64(-1.0)
    whole = clip(a, b, outline_low(faces, body), outline_high(faces, body))
    if whole[0] > whole[1]:
        return none
    flat = clip(a, b, faces.low[body], faces.high[body])
    f = none
    if flat[0] > flat[1]:
        if which == 0:
            f = smallest_gap(faces, body, a, b, whole[0], whole[1])
    elif which == 0:
        f = smallest_gap(faces, body, a, b, whole[0], flat[0])
    else:
        f = smallest_gap(faces, body, a, b, flat[1], whole[1])
    if f <= wp.float64(0.0) or f >= wp.float64(1.0):
        return none
    return f


# --- the points of a triangle with the smallest gap ------------------------------------------------------------------


@wp.func
def lowest_beyond(end: wp.float64, outward: wp.float64, radius: wp.float64, slope: wp.float64) -> wp.float64:
    """Return the coordinate at or beyond an end of the flat part at which slope * p + h(p) is smallest [m]."""
    m = outward * slope
    d = wp.float64(0.0)
    if m < wp.float64(0.0):
        d = wp.min(-m / wp.sqrt(wp.float64(1.0) + m * m), RIM) * radius
    return end + outward * d


@wp.func
def triangle_point(faces: Faces, body: int, a: vec3d, b: vec3d, c: vec3d, corner: int) -> vec3d:
    """Return the weights of the point of a triangle with the smallest gap at or beyond a corner of the flat part.

    One is not positive where that point lies outside the triangle.
    """
    one = wp.float64(1.0)
    ab = b - a
    ac = c - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    if wp.abs(area) <= wp.float64(1e-6) * wp.length(wp.cross(ab, ac)):
        return vec3d(-one, -one, -one)
    slope_0 = (ab[2] * ac[1] - ac[2] * ab[1]) / area
    slope_1 = (ab[0] * ac[2] - ac[0] * ab[2]) / area
    end_0 = faces.low[body][0]
    outward_0 = -one
    radius_0 = faces.fillet_low[body][0]
    if corner % 2 == 1:
        end_0 = faces.high[body][0]
        outward_0 = one
        radius_0 = faces.fillet_high[body][0]
    end_1 = faces.low[body][1]
    outward_1 = -one
    radius_1 = faces.fillet_low[body][1]
    if corner >= 2:
        end_1 = faces.high[body][1]
        outward_1 = one
        radius_1 = faces.fillet_high[body][1]
    p = lowest_beyond(end_0, outward_0, radius_0, slope_0) - a[0]
    q = lowest_beyond(end_1, outward_1, radius_1, slope_1) - a[1]
    weight_b = (p * ac[1] - q * ac[0]) / area
    weight_c = (ab[0] * q - ab[1] * p) / area
    return vec3d(one - weight_b - weight_c, weight_b, weight_c)
