"""Kernels that choose the contact points of a world among the candidates, and take over what is known of them.

Points that depend on each other would make the contact problem singular. Where a flat face ends inside triangles, about
two edges cross its outline for each node beyond it: where the nodes inside touch, keeping one of these points out of
the face keeps them all out. So every point on the flat part must bring in a node of its own, see ``drop_dependent``.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_contact import ContactList, copy_contact, interpolate, interpolate_rest
from defgrasp_ros.simulation.kernels_detection import LOADED_FIRST, SAME_POINT, Scene, preference, touch, weight_of
from defgrasp_ros.simulation.kernels_faces import BODY_COUNT, to_face
from defgrasp_ros.simulation.rows import Rows, world_of

wp.set_module_options({"enable_backward": False})

FLAT = wp.constant(wp.float64(0.99))
"""Component of the contact normal along the face's normal above which a point counts as on the flat part."""
EXACTLY_FLAT = wp.constant(wp.float64(1.0 - 1e-12))
NO_NODE = -1
UNDECIDED = -2
KEPT_SHIFT = wp.constant(wp.float64(0.02))
"""A point found again with weights that changed by less than this stays where it was in the material."""
KEPT_TILT = wp.constant(wp.float64(1e-3))
"""Change of a contact's normal that makes its compliance stale."""


@wp.func
def is_flat(contacts: ContactList, row: int, c: int) -> bool:
    """Whether a candidate lies on the flat part of a face, or nearly so."""
    return contacts.key[row, c] >= 0 and contacts.axis[row, c][0] > FLAT


@wp.func
def is_taken(contacts: ContactList, owned: wp.array2d[int], row: int, count: int, node: int) -> bool:
    """Whether a node is a candidate itself, on the flat part, or belongs to a point that stays."""
    for c in range(count):
        if owned[row, c] == node:
            return True
        nodes = contacts.nodes[row, c]
        if nodes[0] == node and nodes[1] == node and contacts.key[row, c] >= 0:
            # A node beyond the flat part does not speak for it, however little the fillet has dropped there.
            return contacts.axis[row, c][0] > EXACTLY_FLAT
    return False


@wp.kernel
def drop_dependent(
    rows: Rows,
    scene: Scene,
    # In and out:
    proposed: ContactList,  # row: body + BODY_COUNT * row of worlds
    gaps: wp.array2d[wp.float64],  # along the normal of the face [m]
    # Out:
    owned: wp.array2d[int],  # the node that each point on an edge or in a triangle brings in
):
    """Give each point on the flat part a node of its own, the preferred points first; drop what gets none.

    Points that carry force stay in any case.
    """
    i, body = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    row = wp.static(BODY_COUNT) * i + body
    count = wp.min(proposed.count[row], proposed.key.shape[1])
    for c in range(count):
        owned[row, c] = wp.static(NO_NODE)
        nodes = proposed.nodes[row, c]
        if nodes[0] != nodes[1] and is_flat(proposed, row, c):
            owned[row, c] = wp.static(UNDECIDED)
    while True:
        best = int(-1)
        smallest = wp.float64(0.0)
        for c in range(count):
            if owned[row, c] == wp.static(UNDECIDED):
                rank = preference(scene, w, proposed.key[row, c], gaps[row, c])
                if best < 0 or rank < smallest:
                    best = c
                    smallest = rank
        if best < 0:
            break
        own = int(-1)
        largest = SAME_POINT + wp.float64(0.0)
        for k in range(3):
            node = proposed.nodes[row, best][k]
            weight = weight_of(node, proposed.nodes[row, best], proposed.weights[row, best])
            if weight > largest and not is_taken(proposed, owned, row, count, node):
                own = node
                largest = weight
        owned[row, best] = own
        if own == wp.static(NO_NODE) and smallest > -LOADED_FIRST:
            proposed.key[row, best] = -1


@wp.kernel
def join_bodies(
    rows: Rows,
    proposed: ContactList,
    proposed_gap: wp.array2d[wp.float64],
    # Out:
    found: ContactList,
    gap_out: wp.array2d[wp.float64],  # (world, contact): along the normal of the face [m]
    longest: wp.array[int],  # (1,): room that a list has ever needed
):
    """Put the candidates of all bodies of a world into one list; what does not fit is left out."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    count = int(0)
    for body in range(wp.static(BODY_COUNT)):
        row = wp.static(BODY_COUNT) * i + body
        for k in range(wp.min(proposed.count[row], proposed.key.shape[1])):
            if proposed.key[row, k] >= 0:
                if count < found.key.shape[1]:
                    copy_contact(proposed, row, k, found, w, count)
                    gap_out[w, count] = proposed_gap[row, k]
                count += 1
    found.count[w] = wp.min(count, found.key.shape[1])
    wp.atomic_max(longest, 0, count)


@wp.kernel
def carry_forces(
    rows: Rows,
    scene: Scene,
    former: ContactList,
    # In and out:
    found: ContactList,
    # Out:
    compliance_is_stale: wp.array[int],  # (world,): set where the points changed
):
    """Give points found again their force and their place in the material; both lists are sorted by key."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    k = int(0)
    same = int(0)
    for c in range(found.count[w]):
        while k < former.count[w] and former.key[w, k] < found.key[w, c]:
            k += 1
        if k < former.count[w] and former.key[w, k] == found.key[w, c]:
            found.force[w, c] = former.force[w, k]
            found.trend[w, c] = former.trend[w, k]
            shift = wp.max(wp.abs(found.weights[w, c] - former.weights[w, k]))
            if shift < KEPT_SHIFT:
                nodes = former.nodes[w, k]
                weights = former.weights[w, k]
                found.weights[w, c] = weights
                body = found.body[w, c]
                x = interpolate_rest(scene.rest, nodes, weights)
                x += interpolate(scene.displacement, w, nodes, weights)
                touch(scene, w, body, x, to_face(scene.bodies, w, body, x), found, w, c)
                if wp.max(wp.abs(found.axis[w, c] - former.axis[w, k])) < KEPT_TILT:
                    same += 1
    if same != found.count[w] or found.count[w] != former.count[w]:
        compliance_is_stale[w] = 1


@wp.kernel
def count_missing(
    rows: Rows,
    listed: ContactList,
    found: ContactList,
    found_gap: wp.array2d[wp.float64],  # (world, contact): along the normal of the face [m]
    # Out:
    missing_out: wp.array[int],  # (world,): unlisted points inside a body
    longest: wp.array[int],  # (1,): room that a list has ever needed
):
    """Count what would be added to the list of a world; both lists are sorted by key."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    k = int(0)
    unlisted = int(0)
    missing = int(0)
    for c in range(found.count[w]):
        while k < listed.count[w] and listed.key[w, k] < found.key[w, c]:
            k += 1
        if k == listed.count[w] or listed.key[w, k] != found.key[w, c]:
            unlisted += 1
            if found_gap[w, c] < wp.float64(0.0):
                missing += 1
    missing_out[w] = missing
    if missing > 0:
        wp.atomic_max(longest, 0, listed.count[w] + unlisted)
