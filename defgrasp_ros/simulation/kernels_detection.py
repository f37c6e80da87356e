"""Kernels that find the contact points between the object's surface and the bodies.

The gap to a body (see ``kernels_faces``) is a convex function along each edge and over each triangle of the surface,
so the surface stays out of the body when it does so at

    * the nodes within the body's outline,
    * the point of each edge with the smallest gap, where that is inside the edge, and
    * the point of each triangle with the smallest gap, where that is inside the triangle.

On the flat part of a face the gap is linear. Where edge and face are parallel the smallest gap lies on a whole
stretch of the edge, over the flat part; both ends count, so that the choice between them does not flicker. Thus an
edge over the flat part has up to two points, where it leaves it, and each may lie in the fillet beyond, where the gap
has its minimum. A triangle has up to four, one for each corner of the flat part. With sharp edges these are
the crossings of edges with the outline and the outline's corners.

Points that nearly coincide are one. What is chosen among the candidates is in ``kernels_selection``; where the gap of
an edge or a triangle is smallest, in ``kernels_gap``.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_contact import (
    ContactList,
    interpolate,
    interpolate_rest,
)
from defgrasp_ros.simulation.kernels_faces import (
    BODY_COUNT,
    RIM_SLOPE,
    Bodies,
    Faces,
    contact_frame,
    drop,
    is_pad,
    outline_high,
    outline_low,
    to_face,
)
from defgrasp_ros.simulation.kernels_gap import edge_point, triangle_point
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import vec2d, vec3d

wp.set_module_options({"enable_backward": False})

SAME_POINT = wp.constant(wp.float64(0.1))
"""Points whose weights differ by less than this at every node are one."""
DEPTH_IN_EDGE = wp.constant(wp.float64(5e-4))
"""Depth at which a point counts as inside a body, relative to its edge [-], where the margin asks for more: a fine mesh
is there to resolve a fine pressure, and on a coarse one every point more depends on others."""
LOADED_FIRST = wp.constant(wp.float64(1e6))
"""Larger than any depth [m]: puts points that carry force before the others."""
CHUNK = 64
"""Features of the surface per word of the bit field of those that can touch."""

EDGE_POINTS = wp.constant(2)
TRIANGLE_POINTS = wp.constant(4)

# Where a node lies relative to a body; a feature whose nodes share one of the first six bits cannot touch.
IN_FRONT = wp.constant(1)
BEHIND = wp.constant(2)
BEYOND_LOW_0 = wp.constant(4)
BEYOND_HIGH_0 = wp.constant(8)
BEYOND_LOW_1 = wp.constant(16)
BEYOND_HIGH_1 = wp.constant(32)
OVER_FLAT = wp.constant(64)
"""Over the flat part: an edge or triangle there has its smallest gap at a node."""
NODE_BITS = wp.constant(63)
FEATURE_BITS = wp.constant(127)
BITS_PER_BODY = wp.constant(7)


@wp.struct
class Surface:
    """The boundary of the mesh. Its features are numbered: nodes first, then edges, then triangles."""

    nodes: wp.array[int]  # (surface node,)
    triangles: wp.array2d[int]  # (triangle, 3)
    edges: wp.array2d[int]  # (edge, 2)
    incidence_start: wp.array[int]  # (node + 1,): triangles around a node
    incidence_triangle: wp.array[int]  # (incidence,)
    edge_key: int
    """First key of a point on an edge."""
    triangle_key: int
    """First key of a point in a triangle."""
    body_key: int
    """Number of keys per body."""


@wp.struct
class Scene:
    """Everything that the search looks at."""

    surface: Surface
    faces: Faces
    bodies: Bodies
    rest: wp.array[vec3d]  # (node,) [m]
    displacement: wp.array2d[vec3d]  # (world, node) [m]
    start_displacement: wp.array2d[vec3d]  # (world, node), at the start of the step [m]
    normal: wp.array2d[vec3d]  # (world, node): outward
    listed: ContactList
    """Points that are known from before, sorted by key."""
    margin: wp.float64  # gap below which a point is a candidate [m]; see DEPTH_IN_EDGE if negative
    tie: wp.float64  # difference of gaps that does not count [m]
    deep: wp.float64  # depth of a point that must have come through a wall, if the step began there [m]
    places: wp.array2d[int]  # (world, node): bits that tell where a node lies relative to each body


@wp.struct
class Candidate:
    """A point of the surface in front of a body, or in it."""

    key: int
    nodes: wp.vec3i
    weights: vec3d
    place: vec3d  # in the face's frame, see to_face [m]
    outward: vec3d  # of the surface, any length


@wp.func
def position(scene: Scene, world: int, node: int) -> vec3d:
    """Place of a node [m]."""
    return scene.rest[node] + scene.displacement[world, node]


@wp.func
def triangle_normal(scene: Scene, world: int, t: int) -> vec3d:
    """Outward normal of a surface triangle, twice its area long [m^2]."""
    a = position(scene, world, scene.surface.triangles[t, 0])
    b = position(scene, world, scene.surface.triangles[t, 1])
    c = position(scene, world, scene.surface.triangles[t, 2])
    return wp.cross(b - a, c - a)


@wp.func
def within(p: vec3d, low: vec2d, high: vec2d) -> bool:
    """Whether a place on a face lies within a rectangle."""
    return p[0] >= low[0] and p[0] <= high[0] and p[1] >= low[1] and p[1] <= high[1]


@wp.func
def place_bits(scene: Scene, body: int, p: vec3d) -> int:
    """Bits that tell where a place in the frame of a face lies."""
    faces = scene.faces
    low = outline_low(faces, body)
    high = outline_high(faces, body)
    deepest = wp.max(faces.fillet_low[body], faces.fillet_high[body])
    bits = int(0)
    if p[2] > RIM_SLOPE * wp.max(scene.margin, wp.float64(0.0)):
        bits += IN_FRONT
    if p[2] < -faces.depth[body] - deepest[0] - deepest[1]:
        bits += BEHIND
    # A node right on an edge counts as inside, however its strain moves it to and fro.
    if p[0] < low[0] - scene.tie:
        bits += BEYOND_LOW_0
    if p[0] > high[0] + scene.tie:
        bits += BEYOND_HIGH_0
    if p[1] < low[1] - scene.tie:
        bits += BEYOND_LOW_1
    if p[1] > high[1] + scene.tie:
        bits += BEYOND_HIGH_1
    if within(p, faces.low[body], faces.high[body]):
        bits += OVER_FLAT
    return bits


@wp.kernel
def look_at_nodes(rows: Rows, scene: Scene):
    """Outward normal of each surface node, the area-weighted mean of its triangles, and where it lies."""
    i, s = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    n = scene.surface.nodes[s]
    total = vec3d()
    for k in range(scene.surface.incidence_start[n], scene.surface.incidence_start[n + 1]):
        total += triangle_normal(scene, w, scene.surface.incidence_triangle[k])
    scene.normal[w, n] = wp.normalize(total)

    x = position(scene, w, n)
    bits = int(0)
    for body in range(wp.static(BODY_COUNT)):
        bits += place_bits(scene, body, to_face(scene.bodies, w, body, x)) << (BITS_PER_BODY * body)
    scene.places[w, n] = bits


@wp.func
def shared_places(scene: Scene, world: int, feature: int) -> int:
    """Bits that all nodes of a feature have."""
    surface = scene.surface
    node_count = surface.nodes.shape[0]
    edge_count = surface.edges.shape[0]
    if feature < node_count:
        return scene.places[world, surface.nodes[feature]]
    if feature < node_count + edge_count:
        e = feature - node_count
        return scene.places[world, surface.edges[e, 0]] & scene.places[world, surface.edges[e, 1]]
    t = feature - node_count - edge_count
    both = scene.places[world, surface.triangles[t, 0]] & scene.places[world, surface.triangles[t, 1]]
    return both & scene.places[world, surface.triangles[t, 2]]


@wp.func
def feature_count(surface: Surface) -> int:
    """Number of nodes, edges and triangles of the surface."""
    return surface.nodes.shape[0] + surface.edges.shape[0] + surface.triangles.shape[0]


@wp.kernel
def screen_features(rows: Rows, scene: Scene, near_out: wp.array3d[wp.uint64]):
    """Set the bits of the features that can touch a body; output (row, body, chunk)."""
    i, chunk = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    for body in range(wp.static(BODY_COUNT)):
        near_out[i, body, chunk] = wp.uint64(0)
    for k in range(wp.static(CHUNK)):
        feature = chunk * wp.static(CHUNK) + k
        if feature >= feature_count(scene.surface):
            return
        places = shared_places(scene, w, feature)
        excluding = FEATURE_BITS
        if feature < scene.surface.nodes.shape[0]:
            excluding = NODE_BITS
        for body in range(wp.static(BODY_COUNT)):
            if scene.bodies.enabled[w, body] != 0 and ((places >> (BITS_PER_BODY * body)) & excluding) == 0:
                near_out[i, body, chunk] = near_out[i, body, chunk] | (wp.uint64(1) << wp.uint64(k))


# --- one candidate --------------------------------------------------------------------------------------------------


@wp.func
def weight_of(node: int, nodes: wp.vec3i, weights: vec3d) -> wp.float64:
    """Weight of a node in a weighted mean, 0 if it has no part in it."""
    total = wp.float64(0.0)
    for k in range(3):
        if nodes[k] == node:
            total += weights[k]
    return total


@wp.func
def same_point(candidate: Candidate, nodes: wp.vec3i, weights: vec3d) -> bool:
    """Whether a candidate is nearly the same weighted mean as another one."""
    for k in range(3):
        node = candidate.nodes[k]
        mine = weight_of(node, candidate.nodes, candidate.weights)
        if wp.abs(mine - weight_of(node, nodes, weights)) > SAME_POINT:
            return False
    for k in range(3):
        mine = weight_of(nodes[k], candidate.nodes, candidate.weights)
        if wp.abs(mine - weight_of(nodes[k], nodes, weights)) > SAME_POINT:
            return False
    return True


@wp.func
def touch(scene: Scene, world: int, body: int, x: vec3d, place: vec3d, contacts: ContactList, row: int, c: int):
    """Write frame, tangent plane and face normal of a contact at x."""
    h = drop(scene.faces, body, vec2d(place[0], place[1]))
    face = scene.bodies.frame[world, body]
    frame = contact_frame(face, vec2d(h[1], h[2]))
    axis = frame * vec3d(face[0, 0], face[0, 1], face[0, 2])
    here = frame * x
    plane = here[0] - axis[0] * (place[2] + h[0])
    if is_pad(body):
        plane += axis[0] * scene.bodies.opening[world]
    contacts.frame[row, c] = frame
    contacts.axis[row, c] = axis
    contacts.plane[row, c] = plane


@wp.func
def listed_force(contacts: ContactList, world: int, key: int) -> wp.float64:
    """Normal force of the entry with this key in a sorted list [N], -1 where there is none."""
    low = int(0)
    high = int(contacts.count[world])
    while low < high:
        middle = (low + high) // 2
        if contacts.key[world, middle] < key:
            low = middle + 1
        else:
            high = middle
    if low < contacts.count[world] and contacts.key[world, low] == key:
        return contacts.force[world, low][0]
    return wp.float64(-1.0)


@wp.func
def preference(scene: Scene, world: int, key: int, gap: wp.float64) -> wp.float64:
    """Of points that exclude each other the one with the smallest preference stays [m].

    Points that carry force come first, so that the choice does not alternate from step to step; then those that are
    listed already, unless others are deeper by more than a tie.
    """
    force = listed_force(scene.listed, world, key)
    if force > wp.float64(0.0):
        return -LOADED_FIRST - force
    if force == wp.float64(0.0):
        return gap - scene.tie
    return gap


@wp.func
def came_through_a_wall(scene: Scene, world: int, body: int, candidate: Candidate) -> bool:
    """Whether a point was deep behind the face already when the step began: it then is beside the body, or came in
    from there. The walls of a body are no contact surface, and its face has no business with what passes them."""
    x = interpolate_rest(scene.rest, candidate.nodes, candidate.weights)
    x += interpolate(scene.start_displacement, world, candidate.nodes, candidate.weights)
    place = to_face(scene.bodies, world, body, x)
    low = outline_low(scene.faces, body)
    high = outline_high(scene.faces, body)
    nearest = vec2d(wp.clamp(place[0], low[0], high[0]), wp.clamp(place[1], low[1], high[1]))
    gap = place[2] + drop(scene.faces, body, nearest)[0]
    if is_pad(body):
        gap += scene.bodies.start_opening[world] - scene.bodies.opening[world]
    return gap < -scene.deep


@wp.func
def propose(
    scene: Scene,
    world: int,
    body: int,
    candidate: Candidate,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
    row: int,
    count: int,
) -> int:
    """List a candidate, in place of those that it nearly coincides with, and return the number of entries.

    It is not listed if it is too far away or one like it is as deep. Entries that have lost their place have key -1;
    a number above the capacity tells that the list must grow.
    """
    p = candidate.place
    h = drop(scene.faces, body, vec2d(p[0], p[1]))
    outward_here = scene.bodies.frame[world, body] * candidate.outward
    gap = p[2] + h[0]
    distance = gap / wp.sqrt(wp.float64(1.0) + h[1] * h[1] + h[2] * h[2])
    margin = scene.margin
    if margin < wp.float64(0.0):
        edge = wp.length(scene.rest[candidate.nodes[0]] - scene.rest[candidate.nodes[1]])
        if edge > wp.float64(0.0):
            margin = wp.max(margin, -DEPTH_IN_EDGE * edge)
    if distance > margin or gap < -scene.faces.depth[body]:
        return count
    if gap < -scene.deep and came_through_a_wall(scene, world, body, candidate):
        return count
    if outward_here[0] + h[1] * outward_here[1] + h[2] * outward_here[2] >= wp.float64(0.0):
        return count
    capacity = contacts.key.shape[1]
    if candidate.nodes[0] != candidate.nodes[1]:  # nodes come first, and are never the same
        replaced = int(0)
        mine = preference(scene, world, body * scene.surface.body_key + candidate.key, gap)
        for c in range(wp.min(count, capacity)):
            if contacts.key[row, c] >= 0 and same_point(candidate, contacts.nodes[row, c], contacts.weights[row, c]):
                if mine >= preference(scene, world, contacts.key[row, c], gaps[row, c]) - scene.tie:
                    return count
                replaced += 1
        if replaced > 0:
            for c in range(wp.min(count, capacity)):
                if same_point(candidate, contacts.nodes[row, c], contacts.weights[row, c]):
                    contacts.key[row, c] = -1
    if count < capacity:
        contacts.key[row, count] = body * scene.surface.body_key + candidate.key
        contacts.body[row, count] = body
        contacts.nodes[row, count] = candidate.nodes
        contacts.weights[row, count] = candidate.weights
        contacts.force[row, count] = vec3d()
        contacts.trend[row, count] = vec3d()
        gaps[row, count] = gap
        x = interpolate_rest(scene.rest, candidate.nodes, candidate.weights)
        x += interpolate(scene.displacement, world, candidate.nodes, candidate.weights)
        touch(scene, world, body, x, p, contacts, row, count)
    return count + 1


# --- the search ------------------------------------------------------------------------------------------------------


@wp.func
def propose_node(
    scene: Scene,
    world: int,
    body: int,
    n: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
    row: int,
    count: int,
) -> int:
    """List a node; see propose."""
    candidate = Candidate()
    candidate.place = to_face(scene.bodies, world, body, position(scene, world, n))
    candidate.key = n
    candidate.nodes = wp.vec3i(n, n, n)
    candidate.weights = vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    candidate.outward = scene.normal[world, n]
    return propose(scene, world, body, candidate, contacts, gaps, row, count)


@wp.func
def propose_edge(
    scene: Scene,
    world: int,
    body: int,
    e: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
    row: int,
    first: int,
) -> int:
    """List the points of an edge; see propose."""
    count = first
    a = scene.surface.edges[e, 0]
    b = scene.surface.edges[e, 1]
    pa = to_face(scene.bodies, world, body, position(scene, world, a))
    pb = to_face(scene.bodies, world, body, position(scene, world, b))
    candidate = Candidate()
    candidate.nodes = wp.vec3i(a, b, b)
    candidate.outward = scene.normal[world, a] + scene.normal[world, b]
    for k in range(EDGE_POINTS):
        f = edge_point(scene.faces, body, pa, pb, k)
        if f > wp.float64(0.0):
            candidate.key = scene.surface.edge_key + EDGE_POINTS * e + k
            candidate.weights = vec3d(wp.float64(1.0) - f, f, wp.float64(0.0))
            candidate.place = pa + f * (pb - pa)
            count = propose(scene, world, body, candidate, contacts, gaps, row, count)
    return count


@wp.func
def propose_triangle(
    scene: Scene,
    world: int,
    body: int,
    t: int,
    contacts: ContactList,
    gaps: wp.array2d[wp.float64],
    row: int,
    first: int,
) -> int:
    """List the points of a triangle; see propose."""
    count = first
    a = scene.surface.triangles[t, 0]
    b = scene.surface.triangles[t, 1]
    c = scene.surface.triangles[t, 2]
    pa = to_face(scene.bodies, world, body, position(scene, world, a))
    pb = to_face(scene.bodies, world, body, position(scene, world, b))
    pc = to_face(scene.bodies, world, body, position(scene, world, c))
    candidate = Candidate()
    candidate.nodes = wp.vec3i(a, b, c)
    candidate.outward = triangle_normal(scene, world, t)
    for k in range(TRIANGLE_POINTS):
        weights = triangle_point(scene.faces, body, pa, pb, pc, k)
        if wp.min(weights) > wp.float64(0.0):
            candidate.key = scene.surface.triangle_key + TRIANGLE_POINTS * t + k
            candidate.weights = weights
            candidate.place = weights[0] * pa + weights[1] * pb + weights[2] * pc
            count = propose(scene, world, body, candidate, contacts, gaps, row, count)
    return count


@wp.kernel
def propose_contacts(
    rows: Rows,
    scene: Scene,
    near: wp.array3d[wp.uint64],  # (row, body, chunk)
    # Out:
    proposed: ContactList,  # row: body + BODY_COUNT * row of worlds
    gap_out: wp.array2d[wp.float64],  # along the normal of the face [m]
    longest: wp.array[int],  # (1,): room that a list has ever needed
):
    """List the candidates of each world and body nearer than the margin, in ascending order of their keys."""
    i, body = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    row = wp.static(BODY_COUNT) * i + body
    node_count = scene.surface.nodes.shape[0]
    edge_count = scene.surface.edges.shape[0]
    count = int(0)
    for chunk in range(near.shape[2]):
        bits = near[i, body, chunk]
        k = int(0)
        while bits != wp.uint64(0):
            if (bits & wp.uint64(1)) != wp.uint64(0):
                feature = chunk * wp.static(CHUNK) + k
                edge = feature - node_count
                triangle = edge - edge_count
                if edge < 0:
                    node = scene.surface.nodes[feature]
                    count = propose_node(scene, w, body, node, proposed, gap_out, row, count)
                elif triangle < 0:
                    count = propose_edge(scene, w, body, edge, proposed, gap_out, row, count)
                else:
                    count = propose_triangle(scene, w, body, triangle, proposed, gap_out, row, count)
            bits = bits >> wp.uint64(1)
            k += 1
    proposed.count[row] = count
    wp.atomic_max(longest, 0, count)
