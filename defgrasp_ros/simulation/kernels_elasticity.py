"""Kernels of the elastic body: co-rotational linear tetrahedra and the dynamic residual.

Per element, with F = I + sum_a u_a (x) G_a, R = polar rotation of F, S = sym(R^T F) - I:

    sigma = 2 mu S + lambda tr(S) I,      f_a = -V R sigma G_a           (force of the element on node a)

The residual of an implicit Euler step of length h from (u_n, v_n) to u is, per node,

    r = m (g + (v_n - (u - u_n) / h) / h) + f_elastic(u) + f_contact.

Everything is double precision. "world" is one simulated experiment; kernels run over a compact list of worlds:
``worlds[i]`` is the row of the state, ``i`` the row of the work buffers. Sums over elements and contacts are
gathered in a fixed order, so two equal runs give equal bits.
"""

import warp as wp

from defgrasp_ros.simulation.types import mat33d, mat43d, vec2d, vec3d

wp.set_module_options({"enable_backward": False})

POLAR_ITERATIONS = wp.constant(20)
POLAR_TOLERANCE = wp.constant(wp.float64(1e-30))
MIN_DETERMINANT = wp.constant(wp.float64(1e-3))


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
        if wp.ddot(step, step) < POLAR_TOLERANCE:
            break
    return r


@wp.func
def deformation_gradient(x0: vec3d, x1: vec3d, x2: vec3d, x3: vec3d, g: mat43d) -> mat33d:
    """Return I + sum_a u_a (x) G_a of nodal displacements x [m]."""
    f = wp.identity(n=3, dtype=wp.float64)
    f += wp.outer(x0, vec3d(g[0, 0], g[0, 1], g[0, 2]))
    f += wp.outer(x1, vec3d(g[1, 0], g[1, 1], g[1, 2]))
    f += wp.outer(x2, vec3d(g[2, 0], g[2, 1], g[2, 2]))
    f += wp.outer(x3, vec3d(g[3, 0], g[3, 1], g[3, 2]))
    return f


@wp.func
def corotated_strain(r: mat33d, f: mat33d) -> mat33d:
    """Return sym(R^T F) - I."""
    s = wp.transpose(r) * f
    return wp.float64(0.5) * (s + wp.transpose(s)) - wp.identity(n=3, dtype=wp.float64)


@wp.func
def hooke_stress(strain: mat33d, lame: vec2d) -> mat33d:
    """Return 2 mu S + lambda tr(S) I [Pa] with lame = (lambda, mu)."""
    return wp.float64(2.0) * lame[1] * strain + lame[0] * wp.trace(strain) * wp.identity(n=3, dtype=wp.float64)


@wp.kernel
def element_forces(
    # Model:
    tetrahedra: wp.array2d[int],  # (tet, 4)
    gradients: wp.array[mat43d],  # (tet,) [1/m]
    volumes: wp.array[wp.float64],  # (tet,) [m^3]
    lame: vec2d,  # lambda, mu [Pa]
    # State in:
    worlds: wp.array[int],  # (row,)
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    # Out:
    rotation_out: wp.array2d[mat33d],  # (row, tet)
    force_out: wp.array2d[mat43d],  # (row, tet) [N], one row of the matrix per corner
):
    """Polar rotation and elastic nodal forces of each element."""
    i, t = wp.tid()
    w = worlds[i]
    g = gradients[t]
    f = deformation_gradient(
        displacement[w, tetrahedra[t, 0]],
        displacement[w, tetrahedra[t, 1]],
        displacement[w, tetrahedra[t, 2]],
        displacement[w, tetrahedra[t, 3]],
        g,
    )
    r = polar_rotation(f)
    stress = hooke_stress(corotated_strain(r, f), lame)
    rotation_out[i, t] = r
    force_out[i, t] = -volumes[t] * (g * wp.transpose(r * stress))


@wp.kernel
def nodal_rotations(
    # Model:
    incidence_start: wp.array[int],  # (node + 1,)
    incidence_tet: wp.array[int],  # (incidence,)
    volumes: wp.array[wp.float64],  # (tet,) [m^3]
    # In:
    element_rotation: wp.array2d[mat33d],  # (row, tet)
    # Out:
    rotation_out: wp.array2d[mat33d],  # (row, node)
):
    """Polar rotation of the volume-weighted mean of the adjacent elements' rotations."""
    i, n = wp.tid()
    mean = mat33d()
    volume = wp.float64(0.0)
    for k in range(incidence_start[n], incidence_start[n + 1]):
        t = incidence_tet[k]
        mean += volumes[t] * element_rotation[i, t]
        volume += volumes[t]
    rotation_out[i, n] = polar_rotation(mean / volume)


@wp.kernel
def refresh_rotations(
    # In:
    worlds: wp.array[int],  # (row,)
    rotation: wp.array2d[mat33d],  # (row, node)
    tolerance: wp.float64,  # [-], Frobenius norm
    # In and out:
    frozen_rotation: wp.array2d[mat33d],  # (world, node)
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Take the new rotations of a world over where one of its nodes turned more than the tolerance."""
    i = wp.tid()
    w = worlds[i]
    largest = wp.float64(0.0)
    for n in range(rotation.shape[1]):
        change = rotation[i, n] - frozen_rotation[w, n]
        largest = wp.max(largest, wp.ddot(change, change))
    if largest > tolerance * tolerance:
        for n in range(rotation.shape[1]):
            frozen_rotation[w, n] = rotation[i, n]
        compliance_is_stale[w] = 1


@wp.kernel
def dynamic_residual(
    # Model:
    incidence_start: wp.array[int],  # (node + 1,)
    incidence_tet: wp.array[int],  # (incidence,)
    incidence_corner: wp.array[int],  # (incidence,)
    mass: wp.array[wp.float64],  # (node,) [kg]
    step_length: wp.float64,  # [s]
    # State in:
    worlds: wp.array[int],  # (row,)
    gravity: wp.array[vec3d],  # (world,) [m/s^2]
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    start_velocity: wp.array2d[vec3d],  # (world, node) [m/s]
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    element_force: wp.array2d[mat43d],  # (row, tet) [N]
    # Out:
    residual_out: wp.array2d[vec3d],  # (row, node) [N], contact forces still missing
):
    """Inertia, gravity and elastic force of each node."""
    i, n = wp.tid()
    w = worlds[i]
    force = vec3d()
    for k in range(incidence_start[n], incidence_start[n + 1]):
        f = element_force[i, incidence_tet[k]]
        c = incidence_corner[k]
        force += vec3d(f[c, 0], f[c, 1], f[c, 2])
    velocity = (displacement[w, n] - start_displacement[w, n]) / step_length
    acceleration = gravity[w] + (start_velocity[w, n] - velocity) / step_length
    residual_out[i, n] = mass[n] * acceleration + force


@wp.kernel
def rotate_back(
    worlds: wp.array[int],  # (row,)
    rotation: wp.array2d[mat33d],  # (world, node)
    vector: wp.array2d[vec3d],  # (row, node)
    vector_out: wp.array2d[vec3d],  # (row, node)
):
    """Nodal vectors from the deformed to the rest orientation: R_n^T v_n."""
    i, n = wp.tid()
    vector_out[i, n] = wp.transpose(rotation[worlds[i], n]) * vector[i, n]


@wp.kernel
def rotate(
    worlds: wp.array[int],  # (row,)
    rotation: wp.array2d[mat33d],  # (world, node)
    vector: wp.array2d[vec3d],  # (row, node)
    vector_out: wp.array2d[vec3d],  # (row, node)
):
    """Nodal vectors from the rest to the deformed orientation: R_n v_n."""
    i, n = wp.tid()
    vector_out[i, n] = rotation[worlds[i], n] * vector[i, n]


@wp.kernel
def add_correction(
    worlds: wp.array[int],  # (row,)
    correction: wp.array2d[vec3d],  # (row, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
):
    """u += correction."""
    i, n = wp.tid()
    w = worlds[i]
    displacement[w, n] = displacement[w, n] + correction[i, n]


@wp.kernel
def predict(
    worlds: wp.array[int],  # (row,)
    step_length: wp.float64,  # [s]
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    start_velocity: wp.array2d[vec3d],  # (world, node) [m/s]
    displacement_out: wp.array2d[vec3d],  # (world, node) [m]
):
    """u = u_n + h v_n, the start of the iteration."""
    i, n = wp.tid()
    w = worlds[i]
    displacement_out[w, n] = start_displacement[w, n] + step_length * start_velocity[w, n]


@wp.kernel
def accept_step(
    worlds: wp.array[int],  # (row,)
    step_length: wp.float64,  # [s]
    velocity_factor: wp.float64,  # 1: dynamic, 0: quasi-static
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    start_displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
    start_velocity: wp.array2d[vec3d],  # (world, node) [m/s], out
):
    """The end of this step becomes the start of the next."""
    i, n = wp.tid()
    w = worlds[i]
    start_velocity[w, n] = velocity_factor * (displacement[w, n] - start_displacement[w, n]) / step_length
    start_displacement[w, n] = displacement[w, n]


@wp.kernel
def element_stress(
    # Model:
    tetrahedra: wp.array2d[int],  # (tet, 4)
    gradients: wp.array[mat43d],  # (tet,) [1/m]
    lame: vec2d,  # lambda, mu [Pa]
    # State in:
    worlds: wp.array[int],  # (row,)
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    # Out:
    stress_out: wp.array2d[mat33d],  # (row, tet) [Pa], in the element's rotated frame
    energy_density_out: wp.array2d[wp.float64],  # (row, tet) [J/m^3] = 1/2 sigma : epsilon
):
    """Stress and strain energy density of each element."""
    i, t = wp.tid()
    w = worlds[i]
    f = deformation_gradient(
        displacement[w, tetrahedra[t, 0]],
        displacement[w, tetrahedra[t, 1]],
        displacement[w, tetrahedra[t, 2]],
        displacement[w, tetrahedra[t, 3]],
        gradients[t],
    )
    strain = corotated_strain(polar_rotation(f), f)
    stress = hooke_stress(strain, lame)
    stress_out[i, t] = stress
    energy_density_out[i, t] = wp.float64(0.5) * wp.ddot(stress, strain)
