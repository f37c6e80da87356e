"""The rigid bodies that can touch the object: left pad, right pad, platform and palm, as faces with rounded edges.

In the frame of a face (two coordinates p along it, height s over it into the object) a body fills s <= -h(p) inside
its outline. The drop h is 0 on the flat part and follows a circular arc in the fillet along each side,

    h(p) = sum over both coordinates of  r - sqrt(r^2 - d^2),    d = distance beyond the flat part,

so a body is convex, and smooth where two fillets meet. The gap of a point is g = s + h(p), a convex function of the
point: its tangent plane at any p lies outside the body, and a point kept out of that plane is kept out of the body.
"""

import warp as wp

from defgrasp_ros.simulation.types import mat33d, vec2d, vec3d

wp.set_module_options({"enable_backward": False})

LEFT_PAD = wp.constant(0)
RIGHT_PAD = wp.constant(1)
PLATFORM = wp.constant(2)
PALM = wp.constant(3)
BODY_COUNT = 4

RIM = wp.constant(wp.float64(0.999))
"""Share of a fillet's radius over which it counts; the face beyond is a wall, at more than 87 degrees."""
RIM_SLOPE = wp.constant(wp.float64(22.4))
"""Slope of the arc there, RIM / sqrt(1 - RIM^2) [-]."""


@wp.struct
class Faces:
    """Shape of each body's face in its own frame, shape ``(body,)`` [m]."""

    low: wp.array[vec2d]
    """Lower ends of the flat part."""
    high: wp.array[vec2d]
    """Upper ends of the flat part."""
    fillet_low: wp.array[vec2d]
    """Radii of the fillets at the lower ends; 0: a sharp edge."""
    fillet_high: wp.array[vec2d]
    """Radii of the fillets at the upper ends."""
    depth: wp.array[wp.float64]
    """How far behind the face a point still counts as pressed in, and not as beyond the body."""


@wp.struct
class Bodies:
    """Where the bodies of every world are."""

    enabled: wp.array2d[int]  # (world, body)
    frame: wp.array2d[mat33d]  # (world, body): rows normal into the object, two directions along the face
    base: wp.array2d[wp.float64]  # (world, body): n . o of a pad, height of the face along n of the others [m]
    origin: wp.array[vec3d]  # (world,): origin o of the grasp frame, from which places on a face are measured [m]
    opening: wp.array[wp.float64]  # (world,): q, by which each pad stands off o [m]
    start_opening: wp.array[wp.float64]  # (world,): q at the start of the step [m]


@wp.func
def is_pad(body: int) -> bool:
    """Whether a body slides along the closing axis."""
    return body == LEFT_PAD or body == RIGHT_PAD


@wp.func
def face_normal(bodies: Bodies, world: int, body: int) -> vec3d:
    """Normal of the flat part of a face, into the object."""
    frame = bodies.frame[world, body]
    return vec3d(frame[0, 0], frame[0, 1], frame[0, 2])


@wp.func
def to_face(bodies: Bodies, world: int, body: int, x: vec3d) -> vec3d:
    """Place along a face and height over its flat part (p, p, s) of a point [m]."""
    r = bodies.frame[world, body] * (x - bodies.origin[world])
    s = wp.dot(face_normal(bodies, world, body), x) - bodies.base[world, body]
    if is_pad(body):
        s += bodies.opening[world]
    return vec3d(r[1], r[2], s)


@wp.func
def beyond(p: wp.float64, low: wp.float64, high: wp.float64) -> wp.float64:
    """Signed distance of a coordinate beyond an interval, 0 inside [m]."""
    return wp.max(p - high, wp.float64(0.0)) + wp.min(p - low, wp.float64(0.0))


@wp.func
def fillet(d: wp.float64, radius_low: wp.float64, radius_high: wp.float64) -> vec2d:
    """Drop of the face and its slope at a signed distance beyond the flat part [m], [-]; not steeper than the rim."""
    radius = radius_high
    if d < wp.float64(0.0):
        radius = radius_low
    if d == wp.float64(0.0) or radius == wp.float64(0.0):
        return vec2d()
    a = wp.min(wp.abs(d), RIM * radius)
    height = wp.sqrt(radius * radius - a * a)
    return vec2d(radius - height, wp.sign(d) * a / height)


@wp.func
def drop(faces: Faces, body: int, p: vec2d) -> vec3d:
    """h and its two slopes at a place on a face [m], [-], [-]."""
    low = faces.low[body]
    high = faces.high[body]
    first = fillet(beyond(p[0], low[0], high[0]), faces.fillet_low[body][0], faces.fillet_high[body][0])
    second = fillet(beyond(p[1], low[1], high[1]), faces.fillet_low[body][1], faces.fillet_high[body][1])
    return vec3d(first[0] + second[0], first[1], second[1])


@wp.func
def outline_low(faces: Faces, body: int) -> vec2d:
    """Lower ends of the outline, fillets included [m]."""
    return faces.low[body] - RIM * faces.fillet_low[body]


@wp.func
def outline_high(faces: Faces, body: int) -> vec2d:
    """Upper ends of the outline, fillets included [m]."""
    return faces.high[body] + RIM * faces.fillet_high[body]


@wp.func
def contact_frame(face_frame: mat33d, slope: vec2d) -> mat33d:
    """Rows normal, tangent, tangent of a place on a face, where its drop has a slope; on the flat part the face's."""
    one = wp.float64(1.0)
    n = wp.normalize(vec3d(one, slope[0], slope[1]))
    t = wp.normalize(vec3d(-slope[0], one, wp.float64(0.0)))
    return wp.matrix_from_rows(n, t, wp.cross(n, t)) * face_frame
