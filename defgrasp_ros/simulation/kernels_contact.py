"""Contact points: what they are, how they belong to the nodes, and how the bodies move against them.

Three rigid flat bodies can touch the object: left pad, right pad (rectangles that slide along the closing axis)
and the platform (an unbounded plane). Between a flat pad and a triangulated surface the smallest gap lies at

    * a surface node inside the pad's outline,
    * the point where a surface edge crosses the outline, or
    * the point of a surface triangle under a corner of the outline,

so these points, each once, are the contact candidates; the platform needs the nodes alone. A point is a weighted
mean of up to three nodes. It keeps its place in the material during a step.

Contact frame: row 0 is the normal n, from the body into the object; rows 1, 2 span the face. With the opening q
(distance of each pad face from the grasp frame's origin o) the relative motion w of a point x is

    w_n = n . (x - o) + q   (pads),    w_n = n . x - height   (platform),    w_t = t . (x - x_n)  since the step began.
"""

import warp as wp

from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})

LEFT_PAD = wp.constant(0)
RIGHT_PAD = wp.constant(1)
PLATFORM = wp.constant(2)
BODY_COUNT = 3

KEPT_SHIFT = wp.constant(wp.float64(0.02))
"""A crossing that moved by less than this fraction of its edge stays where it was in the material."""


@wp.struct
class Outline:
    """Rectangle of a pad's flat face in the grasp frame [m]."""

    half_width: wp.float64
    bottom: wp.float64
    top: wp.float64
    depth: wp.float64
    """How far behind the face a point still counts as pressed in, and not as beyond the finger [m]."""
    snap: wp.float64
    """How far outside a node still counts as inside [m]."""


@wp.struct
class ContactList:
    """Candidate points of every world; row 'world', ``count[world]`` entries, in ascending order of ``key``."""

    count: wp.array[int]  # (world,)
    key: wp.array2d[int]  # (world, contact): body and mesh feature
    body: wp.array2d[int]  # (world, contact)
    nodes: wp.array2d[wp.vec3i]  # (world, contact)
    weights: wp.array2d[vec3d]  # (world, contact), 0 where a node does not count
    force: wp.array2d[vec3d]  # (world, contact): normal and two tangential components [N]


@wp.struct
class Surface:
    """The boundary of the mesh."""

    nodes: wp.array[int]  # (surface node,)
    triangles: wp.array2d[int]  # (triangle, 3)
    edges: wp.array2d[int]  # (edge, 2)
    incidence_start: wp.array[int]  # (node + 1,): triangles around a node
    incidence_triangle: wp.array[int]  # (incidence,)
    edge_key: int
    """First key of an edge crossing."""
    corner_key: int
    """First key of a pad corner."""
    body_key: int
    """Number of keys per body."""


@wp.struct
class Bodies:
    """The rigid bodies of every world."""

    enabled: wp.array2d[int]  # (world, body)
    frame: wp.array2d[mat33d]  # (world, body): rows normal, tangent, tangent
    base: wp.array2d[wp.float64]  # (world, body): n . o of a pad, height of the platform [m]
    origin: wp.array[vec3d]  # (world,): origin o of the grasp frame [m]
    opening: wp.array[wp.float64]  # (world,): q [m]


@wp.func
def contact_normal(bodies: Bodies, world: int, body: int) -> vec3d:
    """Normal of a body's face, into the object."""
    frame = bodies.frame[world, body]
    return vec3d(frame[0, 0], frame[0, 1], frame[0, 2])


@wp.func
def body_gap(bodies: Bodies, world: int, body: int, x: vec3d) -> wp.float64:
    """Distance of a point from the face of a body [m], negative inside."""
    gap = wp.dot(contact_normal(bodies, world, body), x) - bodies.base[world, body]
    if body != PLATFORM:
        gap += bodies.opening[world]
    return gap


@wp.kernel
def carry_forces(
    worlds: wp.array[int],  # (row,)
    former: ContactList,
    found_gap: wp.array2d[wp.float64],  # (world, contact) [m]
    penetration: wp.float64,  # [m]
    # In and out:
    found: ContactList,
    # Out:
    compliance_is_stale: wp.array[int],  # (world,): set where the points changed
    missing_out: wp.array[int],  # (row,): unlisted points deeper than the penetration
):
    """Give points found again their force and their place in the material; both lists are sorted by key."""
    i = wp.tid()
    w = worlds[i]
    k = int(0)
    same = int(0)
    missing = int(0)
    for c in range(found.count[w]):
        while k < former.count[w] and former.key[w, k] < found.key[w, c]:
            k += 1
        if k < former.count[w] and former.key[w, k] == found.key[w, c]:
            found.force[w, c] = former.force[w, k]
            shift = wp.max(wp.abs(found.weights[w, c] - former.weights[w, k]))
            if shift < KEPT_SHIFT:
                found.weights[w, c] = former.weights[w, k]
                same += 1
        elif found_gap[w, c] < -penetration:
            missing += 1
    if same != found.count[w] or found.count[w] != former.count[w]:
        compliance_is_stale[w] = 1
    missing_out[i] = missing


@wp.func
def copy_contact(source: ContactList, k: int, target: ContactList, c: int, world: int):
    """Copy entry k of one list to entry c of another."""
    target.key[world, c] = source.key[world, k]
    target.body[world, c] = source.body[world, k]
    target.nodes[world, c] = source.nodes[world, k]
    target.weights[world, c] = source.weights[world, k]
    target.force[world, c] = source.force[world, k]


@wp.kernel
def merge_contacts(
    worlds: wp.array[int],  # (row,)
    listed: ContactList,
    found: ContactList,
    # Out:
    merged: ContactList,
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Add the points that were found to those that are listed, which stay as they are; all sorted by key."""
    i = wp.tid()
    w = worlds[i]
    k = int(0)
    count = int(0)
    for c in range(found.count[w]):
        while k < listed.count[w] and listed.key[w, k] < found.key[w, c]:
            copy_contact(listed, k, merged, count, w)
            k += 1
            count += 1
        if k == listed.count[w] or listed.key[w, k] != found.key[w, c]:
            copy_contact(found, c, merged, count, w)
            count += 1
    while k < listed.count[w]:
        copy_contact(listed, k, merged, count, w)
        k += 1
        count += 1
    merged.count[w] = count
    compliance_is_stale[w] = 1


@wp.kernel
def copy_contacts(worlds: wp.array[int], source: ContactList, target: ContactList):
    """Copy the lists of some worlds."""
    i = wp.tid()
    w = worlds[i]
    target.count[w] = source.count[w]
    for c in range(source.count[w]):
        copy_contact(source, c, target, c, w)


@wp.func
def interpolate(field: wp.array2d[vec3d], row: int, nodes: wp.vec3i, weights: vec3d) -> vec3d:
    """Weighted mean of a nodal field."""
    return weights[0] * field[row, nodes[0]] + weights[1] * field[row, nodes[1]] + weights[2] * field[row, nodes[2]]


@wp.func
def interpolate_rest(rest: wp.array[vec3d], nodes: wp.vec3i, weights: vec3d) -> vec3d:
    """Weighted mean of the rest positions."""
    return weights[0] * rest[nodes[0]] + weights[1] * rest[nodes[1]] + weights[2] * rest[nodes[2]]


@wp.kernel
def relative_motion(
    rest: wp.array[vec3d],  # (node,) [m]
    bodies: Bodies,
    contacts: ContactList,
    worlds: wp.array[int],  # (row,)
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    correction: wp.array2d[vec3d],  # (row, node) [m], added to the displacement
    motion_out: wp.array2d[vec3d],  # (row, contact): gap, slip, slip [m]
):
    """Gap and slip over the step of each contact point at displacement + correction."""
    i, c = wp.tid()
    w = worlds[i]
    if c >= contacts.count[w]:
        return
    nodes = contacts.nodes[w, c]
    weights = contacts.weights[w, c]
    body = contacts.body[w, c]
    u = interpolate(displacement, w, nodes, weights) + interpolate(correction, i, nodes, weights)
    slip = bodies.frame[w, body] * (u - interpolate(start_displacement, w, nodes, weights))
    gap = body_gap(bodies, w, body, interpolate_rest(rest, nodes, weights) + u)
    motion_out[i, c] = vec3d(gap, slip[1], slip[2])


@wp.kernel
def scatter_contact_forces(
    bodies: Bodies,
    contacts: ContactList,
    worlds: wp.array[int],  # (row,)
    force: wp.array2d[vec3d],  # (row, contact): normal, tangential, tangential [N]
    nodal_force: wp.array2d[vec3d],  # (row, node) [N], in and out
):
    """Add J^T lambda to the nodal forces."""
    i = wp.tid()
    w = worlds[i]
    for c in range(contacts.count[w]):
        f = wp.transpose(bodies.frame[w, contacts.body[w, c]]) * force[i, c]
        nodes = contacts.nodes[w, c]
        weights = contacts.weights[w, c]
        for k in range(3):
            if weights[k] != wp.float64(0.0):
                nodal_force[i, nodes[k]] = nodal_force[i, nodes[k]] + weights[k] * f


@wp.kernel
def gather_forces(worlds: wp.array[int], contacts: ContactList, force_out: wp.array2d[vec3d]):
    """Copy the forces of the list into a work buffer (row, contact) [N]."""
    i, c = wp.tid()
    w = worlds[i]
    if c < contacts.count[w]:
        force_out[i, c] = contacts.force[w, c]


@wp.kernel
def store_forces(worlds: wp.array[int], force: wp.array2d[vec3d], contacts: ContactList):
    """Copy a work buffer (row, contact) [N] into the forces of the list."""
    i, c = wp.tid()
    w = worlds[i]
    if c < contacts.count[w]:
        contacts.force[w, c] = force[i, c]


@wp.kernel
def move_fingers(
    contacts: ContactList,
    worlds: wp.array[int],  # (row,)
    step_length: wp.float64,  # [s]
    finger_damping: wp.array[wp.float64],  # (world,) [N s/m]
    closing_force: wp.array[wp.float64],  # (world,) [N]
    start_opening: wp.array[wp.float64],  # (world,) [m]
    opening_out: wp.array[wp.float64],  # (world,) [m]
):
    """Opening at the end of the step: c (q - q_n) / h = sum of the pads' normal forces - closing force."""
    i = wp.tid()
    w = worlds[i]
    total = wp.float64(0.0)
    for c in range(contacts.count[w]):
        if contacts.body[w, c] != PLATFORM:
            total += contacts.force[w, c][0]
    opening_out[w] = start_opening[w] + step_length / finger_damping[w] * (total - closing_force[w])


@wp.kernel
def assemble_contact_compliance(
    compliance: wp.array2d[wp.float64],  # (3 node, 3 node) [m/N]
    step_length: wp.float64,  # [s]
    bodies: Bodies,
    contacts: ContactList,
    worlds: wp.array[int],  # (row,)
    rotation: wp.array2d[mat33d],  # (world, node)
    finger_damping: wp.array[wp.float64],  # (world,) [N s/m]
    # Out:
    matrix_out: wp.array3d[wp.float64],  # (world, 3 contact, 3 contact) [m/N]
):
    """Gather W = J R P R^T J^T, and add what the fingers yield: h / c between the normal rows of the pads."""
    i, a, b = wp.tid()
    w = worlds[i]
    if a >= contacts.count[w] or b >= contacts.count[w] or b < a:
        return
    block = mat33d()
    for k in range(3):
        weight_a = contacts.weights[w, a][k]
        if weight_a == wp.float64(0.0):
            continue
        node_a = contacts.nodes[w, a][k]
        row = mat33d()
        for m in range(3):
            weight_b = contacts.weights[w, b][m]
            if weight_b == wp.float64(0.0):
                continue
            node_b = contacts.nodes[w, b][m]
            p = mat33d()
            for x in range(3):
                for y in range(3):
                    p[x, y] = compliance[3 * node_a + x, 3 * node_b + y]
            row += weight_b * (p * wp.transpose(rotation[w, node_b]))
        block += weight_a * (rotation[w, node_a] * row)
    block = bodies.frame[w, contacts.body[w, a]] * block * wp.transpose(bodies.frame[w, contacts.body[w, b]])
    if contacts.body[w, a] != PLATFORM and contacts.body[w, b] != PLATFORM:
        block[0, 0] = block[0, 0] + step_length / finger_damping[w]
    for x in range(3):
        for y in range(3):
            matrix_out[w, 3 * a + x, 3 * b + y] = block[x, y]
            matrix_out[w, 3 * b + y, 3 * a + x] = block[x, y]
