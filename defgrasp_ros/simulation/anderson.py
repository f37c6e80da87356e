"""Anderson acceleration of the quasi-Newton iteration (Anderson 1965; Walker and Ni 2011).

With the iterates u_k, their images g_k = G(u_k) and f_k = g_k - u_k, the next iterate is

    u_{k+1} = g_k - sum_j gamma_j (g_k - g_j),      gamma = argmin | f_k - sum_j gamma_j (f_k - f_j) |

over the last few j. The contact forces belong to the displacements through a linear map, so they are mixed with the
same coefficients; the next contact solution takes them back to their laws.
"""

from __future__ import annotations

import warp as wp

from defgrasp_ros.simulation.rows import Launcher, RowList, Rows, world_of
from defgrasp_ros.simulation.types import vec3d

wp.set_module_options({"enable_backward": False})

DEPTH = wp.constant(4)
"""Earlier iterates that are remembered; the size of the small matrices below."""
REGULARISATION = wp.constant(wp.float64(1e-12))

_vector = wp.types.vector(length=4, dtype=wp.float64)
_matrix = wp.types.matrix(shape=(4, 4), dtype=wp.float64)


class Anderson:
    """History of the iteration of every world."""

    def __init__(self, world_count: int, node_count: int, capacity: int, device: wp.Device):
        slots = DEPTH + 1
        self._launch = Launcher(device)
        self.capacity = capacity
        """Room for contact points per world."""
        self._image = wp.zeros((slots, world_count, node_count), dtype=vec3d, device=device)
        self._change = wp.zeros((slots, world_count, node_count), dtype=vec3d, device=device)
        self._force = wp.zeros((slots, world_count, capacity), dtype=vec3d, device=device)
        self.length = wp.zeros(world_count, dtype=int, device=device)
        """Iterates recorded since the last start, per world."""

    def mix(
        self, rows: RowList, before: wp.array, displacement: wp.array, contact_count: wp.array, contact_force: wp.array
    ) -> None:
        """Replace the images of this iteration by the accelerated iterates.

        Args:
            rows: Worlds.
            before: Iterate u_k (world, node) [m].
            displacement: Image g_k, in and out (world, node) [m].
            contact_count: Contact points (world,).
            contact_force: Contact forces that belong to g_k, in and out (world, contact) [N].
        """
        inputs = [before, displacement, contact_count, contact_force, self.length]
        self._launch(_mix, (rows,), [*inputs, self._image, self._change, self._force])


@wp.func
def solve_symmetric(a: _matrix, b: _vector, size: int) -> _vector:
    """Solve the leading block of a x = b by Cholesky's factorisation; directions without length get 0."""
    factor = _matrix()
    x = _vector()
    for j in range(size):
        pivot = a[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if pivot > REGULARISATION * a[j, j]:
            root = wp.sqrt(pivot)
            factor[j, j] = root
            for i in range(j + 1, size):
                value = a[i, j]
                for k in range(j):
                    value -= factor[i, k] * factor[j, k]
                factor[i, j] = value / root
    for i in range(size):
        if factor[i, i] > wp.float64(0.0):
            value = b[i]
            for k in range(i):
                value -= factor[i, k] * x[k]
            x[i] = value / factor[i, i]
    for m in range(size):
        i = size - 1 - m
        if factor[i, i] > wp.float64(0.0):
            value = x[i]
            for k in range(i + 1, size):
                value -= factor[k, i] * x[k]
            x[i] = value / factor[i, i]
        else:
            x[i] = wp.float64(0.0)
    return x


@wp.kernel
def _mix(
    rows: Rows,
    before: wp.array2d[vec3d],  # (world, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
    contact_count: wp.array[int],  # (world,)
    contact_force: wp.array2d[vec3d],  # (world, contact) [N], in and out
    length: wp.array[int],  # (world,), in and out
    image: wp.array3d[vec3d],  # (slot, world, node) [m], in and out
    change: wp.array3d[vec3d],  # (slot, world, node) [m], in and out
    force: wp.array3d[vec3d],  # (slot, world, contact) [N], in and out
):
    """Record the iterate of a world, then mix it with those before."""
    w = world_of(rows, wp.tid())
    if w < 0:
        return
    slots = DEPTH + 1
    newest = length[w] % slots
    for n in range(before.shape[1]):
        image[newest, w, n] = displacement[w, n]
        change[newest, w, n] = displacement[w, n] - before[w, n]
    for c in range(contact_count[w]):
        force[newest, w, c] = contact_force[w, c]
    earlier = wp.min(length[w], DEPTH)
    length[w] = length[w] + 1
    if earlier == 0:
        return

    gram = _matrix()
    right = _vector()
    for n in range(before.shape[1]):
        f = change[newest, w, n]
        for a in range(earlier):
            da = f - change[(newest + slots - 1 - a) % slots, w, n]
            right[a] = right[a] + wp.dot(f, da)
            for b in range(a + 1):
                gram[a, b] = gram[a, b] + wp.dot(da, f - change[(newest + slots - 1 - b) % slots, w, n])
    for a in range(earlier):
        for b in range(a):
            gram[b, a] = gram[a, b]
    gamma = solve_symmetric(gram, right, earlier)

    for a in range(earlier):
        slot = (newest + slots - 1 - a) % slots
        g = gamma[a]
        for n in range(before.shape[1]):
            displacement[w, n] = displacement[w, n] - g * (image[newest, w, n] - image[slot, w, n])
        for c in range(contact_count[w]):
            contact_force[w, c] = contact_force[w, c] - g * (force[newest, w, c] - force[slot, w, c])
