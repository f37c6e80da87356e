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

Points that depend on each other would make the contact problem singular. Of points that nearly coincide the one with
the smallest gap stays. Where a flat face ends inside triangles, about two edges cross its outline for each node beyond
it: where the nodes inside touch, keeping one of these points out of the face keeps them all out. So every point on
the flat part must bring in a node of its own, see ``drop_dependent``.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_contact import (
    ContactList,
    copy_contact,
    interpolate,
    interpolate_rest,
)
from defgrasp_ros.simulation.kernels_faces import (
    BODY_COUNT,
    RIM,
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
from defgrasp_ros.simulation.types import vec2d, vec3d

wp.set_module_options({"enable_backward": False})

SAME_POINT = wp.constant(wp.float64(0.1))
"""Points whose weights differ by less than this at every node are one."""
FLAT = wp.constant(wp.float64(0.99))
"""Component of the contact normal along the face's normal above which a point counts as on the flat part."""
DEPTH_IN_EDGE = wp.constant(wp.float64(5e-4))
"""Depth at which a point counts as inside a body, relative to its edge [-], where the margin asks for more: a fine mesh
is there to resolve a fine pressure, and on a coarse one every point more depends on others."""
EXACTLY_FLAT = wp.constant(wp.float64(1.0 - 1e-12))
LOADED_FIRST = wp.constant(wp.float64(1e6))
"""Larger than any depth [m]: puts points that carry force before the others."""
NO_NODE = -1
UNDECIDED = -2
KEPT_SHIFT = wp.constant(wp.float64(0.02))
"""A point found again with weights that changed by less than this stays where it was in the material."""
KEPT_TILT = wp.constant(wp.float64(1e-3))
"""Change of a contact's normal that makes its compliance stale."""
BISECTIONS = wp.constant(50)
"""Halvings in the search for the smallest gap along an edge: to rounding."""
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
    normal: wp.array2d[vec3d]  # (world, node): outward
    listed: ContactList
    """Points that are known from before, sorted by key."""
    margin: wp.float64  # gap below which a point is a candidate [m]; see DEPTH_IN_EDGE if negative
    tie: wp.float64  # difference of gaps that does not count [m]
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
    if p[0] < low[0]:
        bits += BEYOND_LOW_0
    if p[0] > high[0]:
        bits += BEYOND_HIGH_0
    if p[1] < low[1]:
        bits += BEYOND_LOW_1
    if p[1] > high[1]:
        bits += BEYOND_HIGH_1
    if within(p, faces.low[body], faces.high[body]):
        bits += OVER_FLAT
    return bits


@wp.kernel
def look_at_nodes(scene: Scene, worlds: wp.array[int]):
    """Outward normal of each surface node, the area-weighted mean of its triangles, and where it lies."""
    i, s = wp.tid()
    w = worlds[i]
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
def screen_features(scene: Scene, worlds: wp.array[int], near_out: wp.array3d[wp.uint64]):
    """Set the bits of the features that can touch a body; output (row, body, chunk)."""
    i, chunk = wp.tid()
    w = worlds[i]
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
        gaps[row, count] = gap
        x = interpolate_rest(scene.rest, candidate.nodes, candidate.weights)
        x += interpolate(scene.displacement, world, candidate.nodes, candidate.weights)
        touch(scene, world, body, x, p, contacts, row, count)
    return count + 1


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
    scene: Scene,
    near: wp.array3d[wp.uint64],  # (row, body, chunk)
    worlds: wp.array[int],  # (row,)
    # Out:
    proposed: ContactList,  # row: body + BODY_COUNT * row of worlds
    gap_out: wp.array2d[wp.float64],  # along the normal of the face [m]
):
    """List the candidates of each world and body nearer than the margin, in ascending order of their keys."""
    i, body = wp.tid()
    w = worlds[i]
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
    scene: Scene,
    worlds: wp.array[int],  # (row,)
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
    w = worlds[i]
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
    proposed: ContactList,
    proposed_gap: wp.array2d[wp.float64],
    worlds: wp.array[int],  # (row,)
    # Out:
    found: ContactList,
    gap_out: wp.array2d[wp.float64],  # (world, contact): along the normal of the face [m]
):
    """Put the candidates of all bodies of a world into one list; a count above the capacity tells to grow."""
    i = wp.tid()
    w = worlds[i]
    count = int(0)
    for body in range(wp.static(BODY_COUNT)):
        row = wp.static(BODY_COUNT) * i + body
        for k in range(wp.min(proposed.count[row], proposed.key.shape[1])):
            if proposed.key[row, k] >= 0:
                if count < found.key.shape[1]:
                    copy_contact(proposed, row, k, found, w, count)
                    gap_out[w, count] = proposed_gap[row, k]
                count += 1
    found.count[w] = count


@wp.kernel
def carry_forces(
    scene: Scene,
    worlds: wp.array[int],  # (row,)
    former: ContactList,
    found_gap: wp.array2d[wp.float64],  # (world, contact): along the normal of the face [m]
    # In and out:
    found: ContactList,
    # Out:
    compliance_is_stale: wp.array[int],  # (world,): set where the points changed
    missing_out: wp.array[int],  # (row,): unlisted points inside a body
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
                nodes = former.nodes[w, k]
                weights = former.weights[w, k]
                found.weights[w, c] = weights
                body = found.body[w, c]
                x = interpolate_rest(scene.rest, nodes, weights)
                x += interpolate(scene.displacement, w, nodes, weights)
                touch(scene, w, body, x, to_face(scene.bodies, w, body, x), found, w, c)
                if wp.max(wp.abs(found.axis[w, c] - former.axis[w, k])) < KEPT_TILT:
                    same += 1
        elif found_gap[w, c] < wp.float64(0.0):
            missing += 1
    if same != found.count[w] or found.count[w] != former.count[w]:
        compliance_is_stale[w] = 1
    missing_out[i] = missing
