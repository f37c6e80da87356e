"""Kernels that find the contact points between the object's surface and the bodies; see ``kernels_contact``."""

import warp as wp

from defgrasp_ros.simulation.kernels_contact import (
    LEFT_PAD,
    PLATFORM,
    Bodies,
    ContactList,
    Outline,
    Surface,
    body_gap,
    contact_normal,
)
from defgrasp_ros.simulation.types import vec2d, vec3d

wp.set_module_options({"enable_backward": False})

SNAP = wp.constant(wp.float64(0.1))
"""Fraction of an edge within which a crossing counts as the node at its end."""


@wp.func
def triangle_normal(
    surface: Surface, rest: wp.array[vec3d], displacement: wp.array2d[vec3d], world: int, t: int
) -> vec3d:
    """Outward normal of a deformed surface triangle, twice its area long [m^2]."""
    a = surface.triangles[t, 0]
    b = surface.triangles[t, 1]
    c = surface.triangles[t, 2]
    xa = rest[a] + displacement[world, a]
    return wp.cross(rest[b] + displacement[world, b] - xa, rest[c] + displacement[world, c] - xa)


@wp.kernel
def surface_normals(
    surface: Surface,
    rest: wp.array[vec3d],  # (node,) [m]
    worlds: wp.array[int],  # (row,)
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    normal_out: wp.array2d[vec3d],  # (row, node)
):
    """Outward normal of each surface node: area-weighted mean of its triangles."""
    i, s = wp.tid()
    n = surface.nodes[s]
    total = vec3d()
    for k in range(surface.incidence_start[n], surface.incidence_start[n + 1]):
        total += triangle_normal(surface, rest, displacement, worlds[i], surface.incidence_triangle[k])
    normal_out[i, n] = wp.normalize(total)


@wp.func
def pad_coordinates(bodies: Bodies, world: int, x: vec3d) -> vec2d:
    """Position of a point across (x) and along (z) the pads in the grasp frame [m]."""
    frame = bodies.frame[world, LEFT_PAD]
    r = x - bodies.origin[world]
    return vec2d(
        frame[1, 0] * r[0] + frame[1, 1] * r[1] + frame[1, 2] * r[2],
        frame[2, 0] * r[0] + frame[2, 1] * r[1] + frame[2, 2] * r[2],
    )


@wp.func
def inside(p: vec2d, outline: Outline, margin: wp.float64) -> bool:
    """Whether a point lies in the outline grown by a margin."""
    return (
        wp.abs(p[0]) <= outline.half_width + margin and p[1] >= outline.bottom - margin and p[1] <= outline.top + margin
    )


@wp.func
def side_crossing(a: vec2d, b: vec2d, outline: Outline, side: int) -> wp.float64:
    """Return the fraction of the segment a-b at which it crosses a side of the outline, or -1."""
    axis = side // 2
    other = 1 - axis
    level = outline.half_width
    if side == 0:
        level = -outline.half_width
    elif side == 2:
        level = outline.bottom
    elif side == 3:
        level = outline.top
    da = a[axis] - level
    db = b[axis] - level
    if da * db >= wp.float64(0.0):
        return wp.float64(-1.0)
    s = da / (da - db)
    along = a[other] + s * (b[other] - a[other])
    low = -outline.half_width
    high = outline.half_width
    if axis == 0:
        low = outline.bottom
        high = outline.top
    if along < low or along > high:
        return wp.float64(-1.0)
    return s


@wp.func
def outline_corner(outline: Outline, corner: int) -> vec2d:
    """Corner 0..3 of the outline."""
    x = outline.half_width
    if corner % 2 == 0:
        x = -x
    z = outline.top
    if corner < 2:
        z = outline.bottom
    return vec2d(x, z)


@wp.func
def barycentric(p: vec2d, a: vec2d, b: vec2d, c: vec2d) -> vec3d:
    """Weights of p in the plane triangle a b c; one is negative where p lies outside."""
    ab = b - a
    ac = c - a
    ap = p - a
    det = ab[0] * ac[1] - ab[1] * ac[0]
    if wp.abs(det) < wp.float64(1e-18):
        return vec3d(wp.float64(-1.0), wp.float64(-1.0), wp.float64(-1.0))
    v = (ap[0] * ac[1] - ap[1] * ac[0]) / det
    w = (ab[0] * ap[1] - ab[1] * ap[0]) / det
    return vec3d(wp.float64(1.0) - v - w, v, w)


@wp.func
def append(
    contacts: ContactList,
    world: int,
    count: int,
    key: int,
    body: int,
    nodes: wp.vec3i,
    weights: vec3d,
    gap: wp.float64,
    gaps: wp.array2d[wp.float64],
) -> int:
    """Write a candidate if there is room, and return the count with it: a count above the capacity tells to grow."""
    if count < contacts.key.shape[1]:
        contacts.key[world, count] = key
        contacts.body[world, count] = body
        contacts.nodes[world, count] = nodes
        contacts.weights[world, count] = weights
        contacts.force[world, count] = vec3d()
        gaps[world, count] = gap
    return count + 1


@wp.func
def find_nodes(
    surface: Surface,
    outline: Outline,
    rest: wp.array[vec3d],
    margin: wp.float64,
    bodies: Bodies,
    world: int,
    body: int,
    displacement: wp.array2d[vec3d],
    normals: wp.array2d[vec3d],
    row: int,
    first: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
) -> int:
    """List the nodes in front of a body after the first entries; return how many entries there are then."""
    count = first
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    towards = contact_normal(bodies, world, body)
    for s in range(surface.nodes.shape[0]):
        n = surface.nodes[s]
        x = rest[n] + displacement[world, n]
        gap = body_gap(bodies, world, body, x)
        if gap > margin or wp.dot(normals[row, n], towards) >= zero:
            continue
        if body != PLATFORM:
            if gap < -outline.depth or not inside(pad_coordinates(bodies, world, x), outline, outline.snap):
                continue
        key = body * surface.body_key + n
        count = append(contacts, world, count, key, body, wp.vec3i(n, n, n), vec3d(one, zero, zero), gap, gaps)
    return count


@wp.func
def find_crossings(
    surface: Surface,
    outline: Outline,
    rest: wp.array[vec3d],
    margin: wp.float64,
    bodies: Bodies,
    world: int,
    body: int,
    displacement: wp.array2d[vec3d],
    normals: wp.array2d[vec3d],
    row: int,
    first: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
) -> int:
    """List the points where surface edges cross the outline of a pad; see find_nodes."""
    count = first
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    towards = contact_normal(bodies, world, body)
    for e in range(surface.edges.shape[0]):
        a = surface.edges[e, 0]
        b = surface.edges[e, 1]
        xa = rest[a] + displacement[world, a]
        xb = rest[b] + displacement[world, b]
        gap_a = body_gap(bodies, world, body, xa)
        gap_b = body_gap(bodies, world, body, xb)
        if wp.min(gap_a, gap_b) > margin or wp.max(gap_a, gap_b) < -outline.depth:
            continue
        if wp.dot(normals[row, a] + normals[row, b], towards) >= zero:
            continue
        pa = pad_coordinates(bodies, world, xa)
        pb = pad_coordinates(bodies, world, xb)
        a_inside = inside(pa, outline, outline.snap)
        b_inside = inside(pb, outline, outline.snap)
        for side in range(4):
            f = side_crossing(pa, pb, outline, side)
            if f < zero or (a_inside and f < SNAP) or (b_inside and f > one - SNAP):
                continue
            gap = (one - f) * gap_a + f * gap_b
            if gap > margin or gap < -outline.depth:
                continue
            key = body * surface.body_key + surface.edge_key + 4 * e + side
            count = append(contacts, world, count, key, body, wp.vec3i(a, b, b), vec3d(one - f, f, zero), gap, gaps)
    return count


@wp.func
def find_corners(
    surface: Surface,
    outline: Outline,
    rest: wp.array[vec3d],
    margin: wp.float64,
    bodies: Bodies,
    world: int,
    body: int,
    displacement: wp.array2d[vec3d],
    first: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
) -> int:
    """List the points of surface triangles under the corners of a pad; see find_nodes."""
    count = first
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    towards = contact_normal(bodies, world, body)
    for t in range(surface.triangles.shape[0]):
        a = surface.triangles[t, 0]
        b = surface.triangles[t, 1]
        c = surface.triangles[t, 2]
        xa = rest[a] + displacement[world, a]
        xb = rest[b] + displacement[world, b]
        xc = rest[c] + displacement[world, c]
        corner_gaps = vec3d(
            body_gap(bodies, world, body, xa), body_gap(bodies, world, body, xb), body_gap(bodies, world, body, xc)
        )
        if wp.min(corner_gaps) > margin or wp.max(corner_gaps) < -outline.depth:
            continue
        if wp.dot(wp.cross(xb - xa, xc - xa), towards) >= zero:
            continue
        pa = pad_coordinates(bodies, world, xa)
        pb = pad_coordinates(bodies, world, xb)
        pc = pad_coordinates(bodies, world, xc)
        for corner in range(4):
            weights = barycentric(outline_corner(outline, corner), pa, pb, pc)
            if wp.min(weights) < zero or wp.max(weights) > one - SNAP:
                continue
            gap = wp.dot(weights, corner_gaps)
            if gap > margin or gap < -outline.depth:
                continue
            key = body * surface.body_key + surface.corner_key + 4 * t + corner
            count = append(contacts, world, count, key, body, wp.vec3i(a, b, c), weights, gap, gaps)
    return count


@wp.kernel
def find_contacts(
    surface: Surface,
    outline: Outline,
    rest: wp.array[vec3d],  # (node,) [m]
    margin: wp.float64,  # [m]
    bodies: Bodies,
    worlds: wp.array[int],  # (row,)
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    normals: wp.array2d[vec3d],  # (row, node)
    # Out:
    contacts: ContactList,
    gap_out: wp.array2d[wp.float64],  # (world, contact) [m]
):
    """List all candidate points of a world with a gap below the margin, in ascending order of their keys.

    A count above the capacity tells that the list must grow.
    """
    i = wp.tid()
    w = worlds[i]
    count = int(0)
    for body in range(3):
        if bodies.enabled[w, body] != 0:
            count = find_nodes(
                surface, outline, rest, margin, bodies, w, body, displacement, normals, i, count, contacts, gap_out
            )
            if body != PLATFORM:
                count = find_crossings(
                    surface, outline, rest, margin, bodies, w, body, displacement, normals, i, count, contacts, gap_out
                )
                count = find_corners(
                    surface, outline, rest, margin, bodies, w, body, displacement, count, contacts, gap_out
                )
    contacts.count[w] = count
