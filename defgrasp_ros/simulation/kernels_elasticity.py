"""Kernels of the elastic body at its nodes: rotations, the dynamic residual, corrections.

The residual of an implicit Euler step of length h from (u_n, v_n) to u is, per node,

    r = M (g + a_frame + (v_n - (u - u_n) / h) / h) + f_elastic(u) + f_contact,

with what a turning frame adds, a_frame.

What an element contributes is in ``kernels_element``. Everything is double precision. "world" is one simulated
experiment; kernels run over a compact list of worlds (:mod:`rows`). Sums over elements and contacts are gathered in a
fixed order, so two equal runs give equal bits.
"""

import warp as wp

from defgrasp_ros.simulation.kernels_element import polar_rotation
from defgrasp_ros.simulation.rows import Rows, world_of
from defgrasp_ros.simulation.types import mat33d, vec3d

wp.set_module_options({"enable_backward": False})


@wp.kernel
def nodal_rotations(
    rows: Rows,
    # Model:
    incidence_start: wp.array[int],  # (node + 1,)
    incidence_tet: wp.array[int],  # (incidence,)
    volumes: wp.array[wp.float64],  # (tet,) [m^3]
    # In:
    element_rotation: wp.array2d[mat33d],  # (world, tet)
    # Out:
    rotation_out: wp.array2d[mat33d],  # (world, node)
):
    """Polar rotation of the volume-weighted mean of the adjacent elements' rotations."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    mean = mat33d()
    volume = wp.float64(0.0)
    for k in range(incidence_start[n], incidence_start[n + 1]):
        t = incidence_tet[k]
        mean += volumes[t] * element_rotation[w, t]
        volume += volumes[t]
    rotation_out[w, n] = polar_rotation(mean / volume)


@wp.kernel
def refresh_rotations(
    rows: Rows,
    # In:
    rotation: wp.array2d[mat33d],  # (world, node)
    tolerance: wp.float64,  # [-], Frobenius norm
    # In and out:
    frozen_rotation: wp.array2d[mat33d],  # (world, node)
    compliance_is_stale: wp.array[int],  # (world,)
):
    """Take the new rotations of a world over where one of its nodes turned more than the tolerance."""
    i = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    largest = wp.float64(0.0)
    for n in range(rotation.shape[1]):
        change = rotation[w, n] - frozen_rotation[w, n]
        largest = wp.max(largest, wp.ddot(change, change))
    if largest > tolerance * tolerance:
        for n in range(rotation.shape[1]):
            frozen_rotation[w, n] = rotation[w, n]
        compliance_is_stale[w] = 1


@wp.struct
class Spin:
    """How the frame of each world turns; it does not where all are zero."""

    centre: wp.array[vec3d]  # (world,) point on the axis [m]
    velocity: wp.array[vec3d]  # (world,) omega [rad/s]
    acceleration: wp.array[vec3d]  # (world,) alpha [rad/s^2]


@wp.func
def frame_acceleration(spin: Spin, world: int, x: vec3d, velocity: vec3d) -> vec3d:
    """Acceleration that a turning frame adds: -alpha x r - omega x (omega x r) - 2 omega x v (Euler, centrifugal,
    Coriolis)."""
    r = x - spin.centre[world]
    omega = spin.velocity[world]
    turning = wp.cross(spin.acceleration[world], r) + wp.cross(omega, wp.cross(omega, r))
    return -(turning + wp.float64(2.0) * wp.cross(omega, velocity))


@wp.kernel
def missing_acceleration(
    rows: Rows,
    rest: wp.array[vec3d],  # (node,) [m]
    step_length: wp.float64,  # [s]
    # State in:
    gravity: wp.array[vec3d],  # (world,) [m/s^2]
    spin: Spin,
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    start_velocity: wp.array2d[vec3d],  # (world, node) [m/s]
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    # Out:
    acceleration_out: wp.array2d[vec3d],  # (world, node) [m/s^2]
):
    """Gravity and what the frame adds, less the acceleration of the step."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    velocity = (displacement[w, n] - start_displacement[w, n]) / step_length
    body = gravity[w] + frame_acceleration(spin, w, rest[n] + displacement[w, n], velocity)
    acceleration_out[w, n] = body + (start_velocity[w, n] - velocity) / step_length


@wp.kernel
def dynamic_residual(
    rows: Rows,
    # Model:
    incidence_start: wp.array[int],  # (node + 1,)
    incidence_entry: wp.array[int],  # (incidence,), column of element_force
    mass_start: wp.array[int],  # (node + 1,)
    mass_node: wp.array[int],  # (entry of M,)
    mass: wp.array[wp.float64],  # (entry of M,) [kg]
    # In:
    acceleration: wp.array2d[vec3d],  # (world, node) [m/s^2], of missing_acceleration
    element_force: wp.array2d[vec3d],  # (world, tet x node of the element) [N]
    # Out:
    residual_out: wp.array2d[vec3d],  # (world, node) [N], contact forces still missing
):
    """Inertia, gravity and elastic force of each node."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    force = vec3d()
    for k in range(incidence_start[n], incidence_start[n + 1]):
        force += element_force[w, incidence_entry[k]]
    for k in range(mass_start[n], mass_start[n + 1]):
        force += mass[k] * acceleration[w, mass_node[k]]
    residual_out[w, n] = force


@wp.kernel
def rotate_back(
    rows: Rows,
    rotation: wp.array2d[mat33d],  # (world, node)
    vector: wp.array2d[vec3d],  # (world, node)
    vector_out: wp.array2d[vec3d],  # (row, node)
):
    """Nodal vectors from the deformed to the rest orientation: R_n^T v_n."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    vector_out[i, n] = wp.transpose(rotation[w, n]) * vector[w, n]


@wp.kernel
def rotate(
    rows: Rows,
    rotation: wp.array2d[mat33d],  # (world, node)
    vector: wp.array2d[vec3d],  # (row, node)
    vector_out: wp.array2d[vec3d],  # (world, node)
):
    """Nodal vectors from the rest to the deformed orientation: R_n v_n."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    vector_out[w, n] = rotation[w, n] * vector[i, n]


@wp.kernel
def add_correction(
    rows: Rows,
    correction: wp.array2d[vec3d],  # (world, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
    before_out: wp.array2d[vec3d],  # (world, node) [m]
    residual_out: wp.array2d[vec3d],  # (world, node) [N]
):
    """u += correction, with u kept; the residual that this follows from is done with."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    before_out[w, n] = displacement[w, n]
    displacement[w, n] = displacement[w, n] + correction[w, n]
    residual_out[w, n] = vec3d()


@wp.kernel
def rotate_and_add(
    rows: Rows,
    rotation: wp.array2d[mat33d],  # (world, node)
    vector: wp.array2d[vec3d],  # (row, node) [m]
    displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
):
    """u += R v."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    displacement[w, n] = displacement[w, n] + rotation[w, n] * vector[i, n]


@wp.kernel
def copy_rotations(rows: Rows, source: wp.array2d[mat33d], target: wp.array2d[mat33d]):
    """Copy the nodal rotations (world, node) of some worlds."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w >= 0:
        target[w, n] = source[w, n]


@wp.kernel
def predict(
    rows: Rows,
    step_length: wp.float64,  # [s]
    start_displacement: wp.array2d[vec3d],  # (world, node) [m]
    velocity: wp.array2d[vec3d],  # (world, node) [m/s]
    displacement_out: wp.array2d[vec3d],  # (world, node) [m]
):
    """u = u_n + h v."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    displacement_out[w, n] = start_displacement[w, n] + step_length * velocity[w, n]


@wp.kernel
def accept_step(
    rows: Rows,
    step_length: wp.float64,  # [s]
    velocity_factor: wp.float64,  # 1: dynamic, 0: quasi-static
    iterations: wp.array[int],  # (world,), of the step
    displacement: wp.array2d[vec3d],  # (world, node) [m]
    start_displacement: wp.array2d[vec3d],  # (world, node) [m], in and out
    start_velocity: wp.array2d[vec3d],  # (world, node) [m/s], out
    trend: wp.array2d[vec3d],  # (world, node) [m/s], out
    opening: wp.array[wp.float64],  # (world,) [m]
    start_opening: wp.array[wp.float64],  # (world,) [m], out
):
    """The end of this step becomes the start of the next. One that needed no iteration has no trend: nothing else would
    end a drift below the tolerance."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    rate = (displacement[w, n] - start_displacement[w, n]) / step_length
    start_velocity[w, n] = velocity_factor * rate
    start_displacement[w, n] = displacement[w, n]
    trend[w, n] = rate
    if iterations[w] == 0:
        trend[w, n] = vec3d()
    if n == 0:
        start_opening[w] = opening[w]


@wp.kernel
def take_back_step(
    rows: Rows,
    start_rotation: wp.array2d[mat33d],  # (world, node)
    start_opening: wp.array[wp.float64],  # (world,) [m]
    rotation: wp.array2d[mat33d],  # (world, node), out
    opening: wp.array[wp.float64],  # (world,) [m], out
    trend: wp.array2d[vec3d],  # (world, node) [m/s], out
):
    """Leave no trace of a step that failed."""
    i, n = wp.tid()
    w = world_of(rows, i)
    if w < 0:
        return
    rotation[w, n] = start_rotation[w, n]
    trend[w, n] = vec3d()
    if n == 0:
        opening[w] = start_opening[w]
