"""Kernels of one finite element: co-rotated linear elasticity at its quadrature points, for every element order.

At a point with H = grad u, F = I + H = R U (polar) and stretch strain S = U - I:

    sigma = 2 mu S + lambda tr(S) I,      P = R sigma,      f_a = -sum over points of V_q P grad N_a.

sigma is the stress in the point's rotated frame and f_a the force of the element on node a. These forces are the exact
negative gradient of the energy sum of V_q / 2 sigma : S, because the rotation is that of the point itself.

S comes from Green's strain, E = (H + H^T + H^T H) / 2 = S + S^2 / 2, so that small strains keep their digits.
Everything is double precision.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from defgrasp_ros.simulation.reference_element import REFERENCE_ELEMENTS
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import mat33d, mat43d, vec2d, vec3d, vec6d

wp.set_module_options({"enable_backward": False})

LAST_CHANGE = wp.constant(wp.float64(1e-17))
"""Square of the change at which Newton's iterations end; they converge quadratically, so less than rounding is left."""
POLAR_ITERATIONS = wp.constant(20)
MIN_DETERMINANT = wp.constant(wp.float64(1e-3))
STRETCH_ITERATIONS = wp.constant(4)
MAX_GREEN_STRAIN = wp.constant(wp.float64(0.2))
"""Frobenius norm of E up to which the iteration for S is stable, as it is for cond(I + 2 E) < 9 (Higham 1986)."""


@wp.func
def cofactor(a: mat33d) -> mat33d:
    """Return det(a) a^-T."""
    r0 = vec3d(a[0, 0], a[0, 1], a[0, 2])
    r1 = vec3d(a[1, 0], a[1, 1], a[1, 2])
    r2 = vec3d(a[2, 0], a[2, 1], a[2, 2])
    return wp.matrix_from_rows(wp.cross(r1, r2), wp.cross(r2, r0), wp.cross(r0, r1))


@wp.func
def rotation_by_svd(f: mat33d) -> mat33d:
    """Return the rotation closest to f, also where f is singular or inverted."""
    u, s, v = wp.svd3(f)
    sign = wp.float64(1.0)
    if wp.determinant(u) * wp.determinant(v) < wp.float64(0.0):
        sign = wp.float64(-1.0)
    return u * wp.diag(vec3d(wp.float64(1.0), wp.float64(1.0), sign)) * wp.transpose(v)


@wp.func
def polar_rotation(f: mat33d) -> mat33d:
    """Return the rotation R of f = R U, by Newton's iteration R <- (R + R^-T) / 2 (Higham 1986)."""
    if wp.determinant(f) < MIN_DETERMINANT:
        return rotation_by_svd(f)
    r = f
    for _i in range(POLAR_ITERATIONS):
        c = cofactor(r)
        det = r[0, 0] * c[0, 0] + r[0, 1] * c[0, 1] + r[0, 2] * c[0, 2]
        step = wp.float64(0.5) * (c / det - r)
        r = r + step
        if wp.ddot(step, step) < LAST_CHANGE:
            break
    return r


# Symmetric matrices are kept as (xx, yy, zz, yz, xz, xy).


@wp.func
def full(a: vec6d) -> mat33d:
    """Return the matrix."""
    return mat33d(a[0], a[5], a[4], a[5], a[1], a[3], a[4], a[3], a[2])


@wp.func
def plus_identity(a: vec6d) -> vec6d:
    """Return I + a."""
    one = wp.float64(1.0)
    return vec6d(one + a[0], one + a[1], one + a[2], a[3], a[4], a[5])


@wp.func
def commuting_product(a: vec6d, b: vec6d) -> vec6d:
    """Return a b, which is symmetric because the two have the same principal axes."""
    return vec6d(
        a[0] * b[0] + a[5] * b[5] + a[4] * b[4],
        a[5] * b[5] + a[1] * b[1] + a[3] * b[3],
        a[4] * b[4] + a[3] * b[3] + a[2] * b[2],
        a[5] * b[4] + a[1] * b[3] + a[3] * b[2],
        a[0] * b[4] + a[5] * b[3] + a[4] * b[2],
        a[0] * b[5] + a[5] * b[1] + a[4] * b[3],
    )


@wp.func
def symmetric_inverse(a: vec6d) -> vec6d:
    """Return a^-1."""
    xx = a[1] * a[2] - a[3] * a[3]
    xy = a[4] * a[3] - a[5] * a[2]
    xz = a[5] * a[3] - a[4] * a[1]
    scale = wp.float64(1.0) / (a[0] * xx + a[5] * xy + a[4] * xz)
    return scale * vec6d(
        xx,
        a[0] * a[2] - a[4] * a[4],
        a[0] * a[1] - a[5] * a[5],
        a[5] * a[4] - a[0] * a[3],
        xz,
        xy,
    )


@wp.func
def green_strain(h: mat33d) -> vec6d:
    """Return (H + H^T + H^T H) / 2."""
    half = wp.float64(0.5)
    x = vec3d(h[0, 0], h[1, 0], h[2, 0])
    y = vec3d(h[0, 1], h[1, 1], h[2, 1])
    z = vec3d(h[0, 2], h[1, 2], h[2, 2])
    return vec6d(
        h[0, 0] + half * wp.dot(x, x),
        h[1, 1] + half * wp.dot(y, y),
        h[2, 2] + half * wp.dot(z, z),
        half * (h[1, 2] + h[2, 1] + wp.dot(y, z)),
        half * (h[0, 2] + h[2, 0] + wp.dot(x, z)),
        half * (h[0, 1] + h[1, 0] + wp.dot(x, y)),
    )


@wp.func
def stretch_strain(green: vec6d) -> vec6d:
    """Return S with S + S^2 / 2 = E: Halley's step from 0, then Newton's S <- (I + S)^-1 (E + S^2 / 2)."""
    half = wp.float64(0.5)
    s = commuting_product(green, symmetric_inverse(plus_identity(half * green)))
    for _i in range(STRETCH_ITERATIONS):
        better = commuting_product(symmetric_inverse(plus_identity(s)), green + half * commuting_product(s, s))
        step = better - s
        s = better
        if wp.dot(step, step) < LAST_CHANGE:
            break
    return s


@wp.func
def polar_strain(h: mat33d):
    """Return the rotation R and the stretch strain S = R^T (I + H) - I."""
    f = wp.identity(n=3, dtype=wp.float64) + h
    green = green_strain(h)
    if wp.dot(green, green) < MAX_GREEN_STRAIN * MAX_GREEN_STRAIN and wp.determinant(f) > wp.float64(0.0):
        strain = stretch_strain(green)
        return f * full(symmetric_inverse(plus_identity(strain))), full(strain)
    r = polar_rotation(f)
    s = wp.transpose(r) * f
    return r, wp.float64(0.5) * (s + wp.transpose(s)) - wp.identity(n=3, dtype=wp.float64)


@wp.func
def hooke_stress(strain: mat33d, lame: vec2d) -> mat33d:
    """Return 2 mu S + lambda tr(S) I [Pa] with lame = (lambda, mu)."""
    return wp.float64(2.0) * lame[1] * strain + lame[0] * wp.trace(strain) * wp.identity(n=3, dtype=wp.float64)


@dataclass(frozen=True)
class ElementKernels:
    """The kernels of one element order."""

    forces: wp.Kernel
    stresses: wp.Kernel
    inversions: wp.Kernel

    def load(self, device: wp.Device) -> None:
        """Load them, as the threads will launch them."""
        for kernel in (self.forces, self.stresses, self.inversions):
            wp.load_module(kernel.module, device=device)


@cache
def element_kernels(order: int) -> ElementKernels:
    """Return the kernels of elements of that order; they differ in nothing but the tables of the reference element."""
    reference = REFERENCE_ELEMENTS[order]
    nodes, points = reference.node_count, reference.point_count
    table = tuple(tuple(tuple(map(float, row)) for row in point) for point in reference.derivatives)
    share = 1.0 / points
    nodal = wp.types.matrix(shape=(nodes, 3), dtype=wp.float64)

    @wp.func
    def displacements(elements: wp.array2d[int], displacement: wp.array2d[vec3d], w: int, t: int):
        """Displacements of an element's nodes [m], one row each."""
        u = nodal()
        for a in range(wp.static(nodes)):
            u[a] = displacement[w, elements[t, a]]
        return u

    def gradient_at(q: int) -> wp.Function:
        @wp.func
        def displacement_gradient(u: nodal, g: mat43d):
            """H = grad u = sum_a u_a (x) grad N_a at point q."""
            h = mat33d()
            for b in range(4):
                slope = vec3d()
                for a in range(wp.static(nodes)):
                    if wp.static(table[q][a][b] != 0.0):
                        slope += wp.float64(wp.static(table[q][a][b])) * u[a]
                h += wp.outer(slope, g[b])
            return h

        return displacement_gradient

    gradients_at = [gradient_at(q) for q in range(points)]

    @wp.kernel(module="unique", enable_backward=False)
    def element_forces(
        rows: Rows,
        # Model:
        elements: wp.array2d[int],  # (tet, node of the element)
        gradients: wp.array[mat43d],  # (tet,) of the barycentric coordinates [1/m]
        volumes: wp.array[wp.float64],  # (tet,) [m^3]
        lame: vec2d,  # lambda, mu [Pa]
        # State in:
        displacement: wp.array2d[vec3d],  # (world, node) [m]
        # Out:
        rotation_out: wp.array2d[mat33d],  # (world, tet), mean over the points
        force_out: wp.array2d[vec3d],  # (world, tet x node of the element) [N]
    ):
        """Mean rotation and elastic nodal forces of each element."""
        i, t = wp.tid()
        w = world_of(rows, i)
        if w < 0:
            return
        g = gradients[t]
        u = displacements(elements, displacement, w, t)
        volume = wp.float64(wp.static(share)) * volumes[t]
        rotation = mat33d()
        force = nodal()
        for q in range(wp.static(points)):
            r, strain = polar_strain(wp.static(gradients_at[q])(u, g))
            rotation += wp.float64(wp.static(share)) * r
            stress = -volume * (r * hooke_stress(strain, lame))
            for b in range(4):
                pull = stress * g[b]
                for a in range(wp.static(nodes)):
                    if wp.static(table[q][a][b] != 0.0):
                        force[a] += wp.float64(wp.static(table[q][a][b])) * pull
        rotation_out[w, t] = rotation
        for a in range(wp.static(nodes)):
            force_out[w, wp.static(nodes) * t + a] = force[a]

    @wp.kernel(module="unique", enable_backward=False)
    def element_stresses(
        rows: Rows,
        # Model:
        elements: wp.array2d[int],  # (tet, node of the element)
        gradients: wp.array[mat43d],  # (tet,) of the barycentric coordinates [1/m]
        lame: vec2d,  # lambda, mu [Pa]
        # State in:
        displacement: wp.array2d[vec3d],  # (world, node) [m]
        # Out:
        stress_out: wp.array2d[mat33d],  # (world, tet x point) [Pa], in the point's rotated frame
        energy_density_out: wp.array2d[wp.float64],  # (world, tet) [J/m^3], mean of sigma : S / 2
    ):
        """Stress at each quadrature point and strain energy density of each element."""
        i, t = wp.tid()
        w = world_of(rows, i)
        if w < 0:
            return
        u = displacements(elements, displacement, w, t)
        density = wp.float64(0.0)
        for q in range(wp.static(points)):
            _rotation, strain = polar_strain(wp.static(gradients_at[q])(u, gradients[t]))
            stress = hooke_stress(strain, lame)
            density += wp.float64(wp.static(0.5 * share)) * wp.ddot(stress, strain)
            stress_out[w, wp.static(points) * t + q] = stress
        energy_density_out[w, t] = density

    @wp.kernel(module="unique", enable_backward=False)
    def element_inversions(
        rows: Rows,
        # Model:
        elements: wp.array2d[int],  # (tet, node of the element)
        gradients: wp.array[mat43d],  # (tet,) of the barycentric coordinates [1/m]
        volumes: wp.array[wp.float64],  # (tet,) [m^3]
        # State in:
        displacement: wp.array2d[vec3d],  # (world, node) [m]
        # Out:
        volume_out: wp.array[wp.float64],  # (world,) [m^3]
    ):
        """Volume of the elements that are turned inside out at one of their points."""
        w = world_of(rows, wp.tid())
        if w < 0:
            return
        total = wp.float64(0.0)
        for t in range(elements.shape[0]):
            u = displacements(elements, displacement, w, t)
            inverted = int(0)
            for q in range(wp.static(points)):
                f = wp.identity(n=3, dtype=wp.float64) + wp.static(gradients_at[q])(u, gradients[t])
                if wp.determinant(f) <= wp.float64(0.0):
                    inverted = 1
            if inverted == 1:
                total += volumes[t]
        volume_out[w] = total

    return ElementKernels(element_forces, element_stresses, element_inversions)
