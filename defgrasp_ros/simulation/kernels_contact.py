"""Contact points: how they belong to the nodes, and how the bodies move against them.

Where the points lie is in ``kernels_detection``; the bodies are in ``kernels_faces``. A point is a weighted mean of up
to three nodes and keeps its place in the material during a step. So does its contact frame: row 0 is the normal n of
the body under the point, into the object; rows 1, 2 span the tangent plane. With the face normal a in that frame and
the opening q of the pads (0 for the other bodies) the relative motion w of a point x is

    w_n = n . x + a_n q - plane,    w_t = t . (x - x_n) + a_t (q - q_n)  since the step began.

On the flat part of a pad a = (1, 0, 0). The force of a pad along the closing axis, which moves the finger, is
a . lambda, friction included.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_block_matrix import place_in_half
from defgrasp_ros.simulation.kernels_faces import Bodies, is_pad
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})


@wp.struct
class ContactList:
    """Contact points of every world; row 'world', ``count[world]`` entries, in ascending order of ``key``."""

    count: wp.array[int]  # (world,)
    key: wp.array2d[int]  # (world, contact): body and mesh feature
    body: wp.array2d[int]  # (world, contact)
    nodes: wp.array2d[wp.vec3i]  # (world, contact)
    weights: wp.array2d[vec3d]  # (world, contact), 0 where a node does not count
    frame: wp.array2d[mat33d]  # (world, contact): rows normal, tangent, tangent
    plane: wp.array2d[wp.float64]  # (world, contact): the body's tangent plane, at opening 0, along the normal [m]
    axis: wp.array2d[vec3d]  # (world, contact): normal of the body's face in the contact frame
    force: wp.array2d[vec3d]  # (world, contact): normal and two tangential components [N]
    trend: wp.array2d[vec3d]  # (world, contact): rate at which the last step changed the force [N/s]


@wp.func
def copy_contact(source: ContactList, source_row: int, k: int, target: ContactList, target_row: int, c: int):
    """Copy entry k of a row of one list to entry c of a row of another."""
    target.key[target_row, c] = source.key[source_row, k]
    target.body[target_row, c] = source.body[source_row, k]
    target.nodes[target_row, c] = source.nodes[source_row, k]
    target.weights[target_row, c] = source.weights[source_row, k]
    target.frame[target_row, c] = source.frame[source_row, k]
    target.plane[target_row, c] = source.plane[source_row, k]
    target.axis[target_row, c] = source.axis[source_row, k]
    target.force[target_row, c] = source.force[source_row, k]
    target.trend[target_row, c] = source.trend[source_row, k]


@wp.func
def copy_list(source: ContactList, target: ContactList, world: int):
    """Copy the list of a world."""
    target.count[world] = source.count[world]
    for c in range(source.count[world]):
        copy_contact(source, world, c, target, world, c)


@wp.kernel
def merge_contacts(
    rows: Rows,
    missing: wp.array[int],  # (world,): whether there is anything to add
    longest: wp.array[int],  # (1,): nothing is done where it does not fit
    found: ContactList,
    # In and out:
    listed: ContactList,
    # Out:
    merged: ContactList,
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Add the points that were found to those that are listed, which stay as they are; all sorted by key."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    if missing[w] == 0 or longest[0] > listed.key.shape[1]:
        return
    k = int(0)
    count = int(0)
    for c in range(found.count[w]):
        while k < listed.count[w] and listed.key[w, k] < found.key[w, c]:
            copy_contact(listed, w, k, merged, w, count)
            k += 1
            count += 1
        if k == listed.count[w] or listed.key[w, k] != found.key[w, c]:
            copy_contact(found, w, c, merged, w, count)
            count += 1
    while k < listed.count[w]:
        copy_contact(listed, w, k, merged, w, count)
        k += 1
        count += 1
    merged.count[w] = count
    copy_list(merged, listed, w)
    compliance_is_stale[w] = 1


@wp.kernel
def copy_contacts(rows: Rows, longest: wp.array[int], source: ContactList, target: ContactList):
    """Copy the lists of some worlds, unless the longest (1,) does not fit."""
    w = world_of(rows, wp.tid())
    if w >= 0 and longest[0] <= target.key.shape[1]:
        copy_list(source, target, w)


@wp.kernel
def remember_contacts(
    rows: Rows,
    step_length: wp.float64,  # of the step that begins [s]
    assembled_step: wp.array[wp.float64],  # (world,): for which the compliance was assembled [s]
    contacts: ContactList,
    # Out:
    remembered: ContactList,
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Keep the lists of worlds that begin a step."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    copy_list(contacts, remembered, w)
    if assembled_step[w] != step_length:
        compliance_is_stale[w] = 1


@wp.kernel
def take_back_contacts(
    rows: Rows,
    remembered: ContactList,
    # Out:
    contacts: ContactList,
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Take the lists that were remembered, without their trends: they may have led astray."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    copy_list(remembered, contacts, w)
    for c in range(contacts.count[w]):
        contacts.trend[w, c] = vec3d()
    compliance_is_stale[w] = 1


@wp.kernel
def find_trends(
    rows: Rows,
    step_length: wp.float64,
    iterations: wp.array[int],  # (world,), of the step
    former: ContactList,
    contacts: ContactList,
):
    """Note how fast the forces changed since ``former``; both lists are sorted. Those of new points have no trend, nor
    have those of worlds that needed no iteration: nothing else would end a drift below the tolerance."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    k = int(0)
    for c in range(contacts.count[w]):
        while k < former.count[w] and former.key[w, k] < contacts.key[w, c]:
            k += 1
        contacts.trend[w, c] = vec3d()
        if iterations[w] > 0 and k < former.count[w] and former.key[w, k] == contacts.key[w, c]:
            contacts.trend[w, c] = (contacts.force[w, c] - former.force[w, k]) / step_length


@wp.kernel
def extrapolate_forces(rows: Rows, step_length: wp.float64, contacts: ContactList):
    """Let the forces follow their trends for a step; points that would pull carry nothing."""
    i, c = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    if c >= contacts.count[w]:
        return
    force = contacts.force[w, c] + step_length * contacts.trend[w, c]
    if force[0] <= wp.float64(0.0):
        force = vec3d()
    contacts.force[w, c] = force


@wp.func
def interpolate(field: wp.array2d[vec3d], row: int, nodes: wp.vec3i, weights: vec3d) -> vec3d:
    """Weighted mean of a nodal field."""
    return weights[0] * field[row, nodes[0]] + weights[1] * field[row, nodes[1]] + weights[2] * field[row, nodes[2]]


@wp.func
def interpolate_rest(rest: wp.array[vec3d], nodes: wp.vec3i, weights: vec3d) -> vec3d:
    """Weighted mean of the rest positions."""
    return weights[0] * rest[nodes[0]] + weights[1] * rest[nodes[1]] + weights[2] * rest[nodes[2]]


@wp.kernel
def contact_state(
    rows: Rows,
    rest: wp.array[vec3d],  # (node,) [m]
    bodies: Bodies,
    contacts: ContactList,
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    correction: wp.array2d[vec3d],  # (world, node) [m], added to the displacement
    motion_out: wp.array2d[vec3d],  # (row, contact): gap, slip, slip [m]
    force_out: wp.array2d[vec3d],  # (row, contact) [N]
):
    """Gap and slip over the step of each contact point at displacement + correction, and its force."""
    i, c = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    if c >= contacts.count[w]:
        return
    nodes = contacts.nodes[w, c]
    weights = contacts.weights[w, c]
    frame = contacts.frame[w, c]
    axis = contacts.axis[w, c]
    u = interpolate(displacement, w, nodes, weights) + interpolate(correction, w, nodes, weights)
    place = frame * (interpolate_rest(rest, nodes, weights) + u)
    slip = frame * (u - interpolate(start_displacement, w, nodes, weights))
    gap = place[0] - contacts.plane[w, c]
    if is_pad(contacts.body[w, c]):
        gap += axis[0] * bodies.opening[w]
        slip += (bodies.opening[w] - bodies.start_opening[w]) * axis
    motion_out[i, c] = vec3d(gap, slip[1], slip[2])
    force_out[i, c] = contacts.force[w, c]


@wp.func
def add_nodal_force(contacts: ContactList, world: int, c: int, force: vec3d, nodal_force: wp.array2d[vec3d]):
    """Add J^T of one contact's force (normal, tangential, tangential) [N] to the nodal forces (world, node)."""
    f = wp.transpose(contacts.frame[world, c]) * force
    nodes = contacts.nodes[world, c]
    weights = contacts.weights[world, c]
    for k in range(3):
        if weights[k] != wp.float64(0.0):
            nodal_force[world, nodes[k]] = nodal_force[world, nodes[k]] + weights[k] * f


@wp.kernel
def add_forces(rows: Rows, contacts: ContactList, nodal_force: wp.array2d[vec3d]):
    """Add J^T lambda to the nodal forces (world, node) [N]."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    for c in range(contacts.count[w]):
        add_nodal_force(contacts, w, c, contacts.force[w, c], nodal_force)


@wp.kernel
def take_forces(
    rows: Rows,
    force: wp.array2d[vec3d],  # (row, contact) [N]
    attempts: wp.array[int],  # (row,): methods that it took to find them
    # In and out:
    contacts: ContactList,
    nodal_force: wp.array2d[vec3d],  # (world, node) [N]
    hard: wp.array[int],  # (world,): how often it took more than one
):
    """Put new forces into the list, and add what they change, J^T (lambda' - lambda), to the nodal forces."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    for c in range(contacts.count[w]):
        add_nodal_force(contacts, w, c, force[i, c] - contacts.force[w, c], nodal_force)
        contacts.force[w, c] = force[i, c]
    if attempts[i] > 1:
        hard[w] = hard[w] + 1


@wp.kernel
def move_fingers(
    rows: Rows,
    contacts: ContactList,
    step_length: wp.float64,  # [s]
    finger_damping: wp.array[wp.float64],  # (world,) [N s/m]
    closing_force: wp.array[wp.float64],  # (world,) [N]
    start_opening: wp.array[wp.float64],  # (world,) [m]
    opening_out: wp.array[wp.float64],  # (world,) [m]
):
    """Opening at the end of the step: c (q - q_n) / h = force of both pads along the closing axis - F."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    total = wp.float64(0.0)
    for c in range(contacts.count[w]):
        if is_pad(contacts.body[w, c]):
            total += wp.dot(contacts.axis[w, c], contacts.force[w, c])
    opening_out[w] = start_opening[w] + step_length / finger_damping[w] * (total - closing_force[w])


@wp.func
def compliance_block(
    compliance: wp.array2d[wp.float64],
    contacts: ContactList,
    rotation: wp.array2d[mat33d],
    world: int,
    a: int,
    b: int,
) -> mat33d:
    """Gather the block of J R P R^T J^T that says how contact a moves under the force of contact b [m/N]."""
    block = mat33d()
    for k in range(3):
        weight_a = contacts.weights[world, a][k]
        if weight_a == wp.float64(0.0):
            continue
        node_a = contacts.nodes[world, a][k]
        row = mat33d()
        for m in range(3):
            weight_b = contacts.weights[world, b][m]
            if weight_b == wp.float64(0.0):
                continue
            node_b = contacts.nodes[world, b][m]
            p = mat33d()
            for x in range(3):
                for y in range(3):
                    p[x, y] = compliance[3 * node_a + x, 3 * node_b + y]
            row += weight_b * (p * wp.transpose(rotation[world, node_b]))
        block += weight_a * (rotation[world, node_a] * row)
    return contacts.frame[world, a] * block * wp.transpose(contacts.frame[world, b])


@wp.kernel
def assemble_contact_compliance(
    rows: Rows,
    compliance: wp.array2d[wp.float64],  # (3 node, 3 node) [m/N]
    step_length: wp.float64,  # [s]
    contacts: ContactList,
    rotation: wp.array2d[mat33d],  # (world, node)
    finger_damping: wp.array[wp.float64],  # (world,) [N s/m]
    # Out:
    matrix_out: wp.array2d[mat33d],  # (world, place): upper half [m/N]
    is_stale_out: wp.array[int],  # (world,)
    assembled_step_out: wp.array[wp.float64],  # (world,) [s]
):
    """Gather W = J R P R^T J^T, and add what the fingers yield along the closing axis: h / c a a^T."""
    i, a = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    if a == 0:
        is_stale_out[w] = 0
        assembled_step_out[w] = step_length
    if a >= contacts.count[w]:
        return
    for b in range(a, contacts.count[w]):
        block = compliance_block(compliance, contacts, rotation, w, a, b)
        if is_pad(contacts.body[w, a]) and is_pad(contacts.body[w, b]):
            block += step_length / finger_damping[w] * wp.outer(contacts.axis[w, a], contacts.axis[w, b])
        matrix_out[w, place_in_half(a, b, contacts.count[w])] = block
