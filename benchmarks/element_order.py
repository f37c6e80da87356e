"""Discretisation error of both element orders against node count and cost; prints the tables of docs/element_order.md.

Run: ``python benchmarks/element_order.py [held] [sphere] [cantilever] [modes]`` (all without argument; four minutes).
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
import warp as wp
from scipy.spatial.transform import Rotation

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper, load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tetrahedralize import tetrahedralize
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.device_model import DeviceModel
from defgrasp_ros.simulation.rest_system import RestSystem, rest_stiffness
from defgrasp_ros.simulation.rows import RowList
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.simulation.types import mat33d, vec3d

WORLD = np.array([0])
MODULUS = 2e5
BLOCK = (0.06, 0.04, 0.04)
SQUARE_PADS = Gripper(
    name="square pads of 20 mm",
    pad_half_width=0.01,
    pad_bottom=-0.01,
    pad_top=0.01,
    tip=0.012,
    finger_thickness=0.012,
    max_opening=0.05,
    max_force=100.0,
    hand_to_tcp=0.1,
    closing_speed=0.05,
)
PAD_TRAVEL = 0.2282e-3
"""Converged travel of each pad [m]: CalculiX, C3D10, rigid frictional pads, 1.749 N each.

Quadratic hexahedra of scikit-fem, graded towards the edges of glued pads, give 0.2236, 0.2254, 0.2265 mm and rise."""
FREE_BLOCK_MODES = np.array([0.28390, 0.36346, 0.36346, 0.46718, 0.47867, 0.47951, 0.47951])
"""f L / c0 of a free 60 x 40 x 40 mm block at nu = 0.3, by Ritz's method with Legendre polynomials of degree 12."""


def block(extents: tuple[float, float, float], cells: tuple[int, int, int], order: int) -> ObjectModel:
    """A block of the standard material."""
    return ObjectModel("block", replace(box(extents, cells), element_order=order), Material(MODULUS))


def element_pass(model: ObjectModel, worlds: int = 16) -> float:
    """Return the processor time of the elastic forces of one world [s], best of ten."""
    device = wp.get_device("cpu")
    constants = DeviceModel(model, load_gripper(), RestSystem(model).mass, device)
    displacement = wp.zeros((worlds, constants.node_count), dtype=vec3d, device=device)
    bend = 0.02 * model.mesh.vertices[:, [1, 2, 0]] * [1.0, -1.0, 0.5]
    displacement.assign(np.tile(bend, (worlds, 1, 1)))
    rows = RowList(worlds, device).assign(np.arange(worlds)).device
    rotation = wp.zeros((worlds, constants.tet_count), dtype=mat33d, device=device)
    force = wp.zeros((worlds, constants.entry_count), dtype=vec3d, device=device)
    inputs = [rows, constants.elements, constants.gradients, constants.volumes, constants.lame, displacement]
    times = []
    for _ in range(10):
        start = time.process_time()
        dim = (worlds, constants.tet_count)
        wp.launch(constants.kernels.forces, dim=dim, inputs=inputs, outputs=[rotation, force], device=device)
        times.append(time.process_time() - start)
    return min(times) / worlds


def row(model: ObjectModel, cells: str, *values: str) -> None:
    """Print one line of a table."""
    mesh = model.mesh
    start = [str(mesh.element_order), cells, str(len(mesh.vertices)), str(len(mesh.tetrahedra))]
    print("| " + " | ".join([*start, *values, f"{1e3 * element_pass(model):.2f}"]) + " |", flush=True)


def table(title: str, *columns: str) -> None:
    """Print the head of a table."""
    names = ["order", "cells", "nodes", "tetrahedra", *columns, "element pass [ms]"]
    print(f"\n{title}\n\n| " + " | ".join(names) + " |\n|" + " ---: |" * len(names), flush=True)


def squeeze(model: ObjectModel, gripper: Gripper, opening: float, force: float) -> tuple[float, float]:
    """Return the travel of each pad [m] under a sum of pad forces [N] without gravity, and iterations per step."""
    simulator = Simulator(model, gripper, 1)
    simulator.set_gravity(WORLD, np.zeros(3))
    grasp = Grasp(np.zeros(3), Rotation.identity().as_quat())
    simulator.place_gripper(WORLD, [grasp], np.array([opening]), np.array([force]))
    iterations, steps = 0, 50
    for count in range(1, steps + 1):
        closing = np.array([force * min(1.0, count / 20)])
        report = simulator.step(WORLD, 0.005, closing, np.array([-1.0]), quasi_static=True)
        assert report.converged.all()
        iterations += int(report.iterations[0])
    return opening - simulator.openings(WORLD)[0], iterations / steps


def held_block() -> None:
    """A block between two rough pads, 1.749 N each; travel of a pad."""
    table("Held block", "travel [mm]", "error", "iterations per step")
    for order, cells in (
        (1, (6, 4, 4)), (1, (9, 6, 4)), (1, (12, 8, 8)), (1, (15, 10, 10)), (1, (18, 12, 12)),
        (2, (3, 2, 2)), (2, (4, 3, 3)), (2, (6, 4, 4)), (2, (8, 6, 6)), (2, (9, 6, 6)),
    ):  # fmt: skip
        model = block(BLOCK, cells, order)
        travel, iterations = squeeze(model, SQUARE_PADS, BLOCK[1] / 2, 2 * 1.749)
        row(
            model,
            " x ".join(map(str, cells)),
            f"{1e3 * travel:.4f}",
            f"{travel / PAD_TRAVEL - 1:+.1%}",
            f"{iterations:.1f}",
        )


def held_sphere() -> None:
    """A sphere of radius 20 mm between two pads, 1 N each; travel of a pad; a coarse mesh is a coarse sphere."""
    import trimesh

    table("Held sphere", "travel [mm]", "iterations per step")
    radius = 0.02
    for order, edge in ((1, 8e-3), (1, 6e-3), (1, 4.5e-3), (1, 3.6e-3), (2, 16e-3), (2, 12e-3), (2, 9e-3), (2, 7.2e-3)):
        sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius)
        mesh = tetrahedralize(np.asarray(sphere.vertices), np.asarray(sphere.faces), edge)
        model = ObjectModel("sphere", replace(mesh, element_order=order), Material(MODULUS))
        travel, iterations = squeeze(model, SQUARE_PADS, radius, 2.0)
        row(model, f"{1e3 * edge:.1f} mm", f"{1e3 * travel:.4f}", f"{iterations:.1f}")


def cantilever() -> None:
    """A clamped beam of 10 : 1 under a tip load: deflection against scikit-fem, stress against beam theory."""
    table("Cantilever", "deflection error", "largest bending stress at mid-length, error")
    length, height, load = 0.1, 0.01, 1e-4
    surface_stress = load * (length / 2.0) * (height / 2.0) / (height**4 / 12.0)
    deflection = cantilever_by_scikit_fem(length, height, load)
    for order, cells in (
        (1, (10, 1, 1)), (1, (20, 2, 2)), (1, (30, 3, 3)), (1, (40, 4, 4)), (1, (60, 6, 6)),
        (2, (5, 1, 1)), (2, (10, 1, 1)), (2, (15, 2, 2)), (2, (20, 2, 2)), (2, (30, 3, 3)),
    ):  # fmt: skip
        model = block((length, height, height), cells, order)
        mesh, x = model.mesh, model.mesh.vertices[:, 0]
        share = end_shares(model)
        free = np.flatnonzero(np.repeat(x > -length / 2 + 1e-9, 3))
        force = np.zeros((len(x), 3))
        force[:, 2] = load * share
        u = np.zeros(force.size)
        stiffness = rest_stiffness(model).tocsc()[free][:, free]
        u[free] = scipy.sparse.linalg.spsolve(stiffness, force.ravel()[free])
        tip = share @ u[2::3]
        simulator = Simulator(model, SQUARE_PADS, 1)
        simulator.set_displacement(WORLD, u.reshape(-1, 3))
        stress, _ = simulator.point_stresses(WORLD)
        middle = np.abs(mesh.vertices[mesh.tetrahedra].mean(axis=1)[:, 0]) < length / cells[0]
        peak = np.abs(stress[0][middle][..., 0, 0]).max()
        row(model, " x ".join(map(str, cells)), f"{tip / deflection - 1:+.2%}", f"{peak / surface_stress - 1:+.0%}")


def cantilever_by_scikit_fem(length: float, height: float, load: float) -> float:
    """Mean deflection of the loaded end [m] by an independent library, quadratic hexahedra."""
    import skfem
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    grid = [np.linspace(0.0, length, 41), np.linspace(0.0, height, 5), np.linspace(0.0, height, 5)]
    mesh = skfem.MeshHex.init_tensor(*grid)
    element = skfem.ElementVector(skfem.ElementHex2())
    basis = skfem.Basis(mesh, element, intorder=4)
    end = skfem.FacetBasis(mesh, element, facets=mesh.facets_satisfying(lambda x: x[0] > length - 1e-9), intorder=4)
    mean = skfem.LinearForm(lambda v, w: v[2] / height**2).assemble(end)
    stiffness = linear_elasticity(*lame_parameters(MODULUS, 0.3)).assemble(basis)
    clamped = basis.get_dofs(lambda x: x[0] < 1e-9).all()
    return mean @ skfem.solve(*skfem.condense(stiffness, load * mean, D=clamped))


def end_shares(model: ObjectModel) -> np.ndarray:
    """Share of each node in a uniform traction on the end face x = max, from flat surface triangles."""
    vertices, triangles = model.mesh.vertices, model.mesh.surface_triangles
    at_end = triangles[(vertices[triangles, 0] > vertices[:, 0].max() - 1e-9).all(axis=1)]
    a, b, c = np.moveaxis(vertices[at_end], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    share = np.bincount(at_end.ravel(), np.repeat(areas, 3), minlength=len(vertices))
    return share / share.sum()


def modes() -> None:
    """Natural frequencies of a free block."""
    table("Free block", "largest error of 7 frequencies", "first", "mean absolute")
    wave_speed = np.sqrt(MODULUS / 1000.0)
    for order, cells in (
        (1, (6, 4, 4)), (1, (9, 6, 6)), (1, (12, 8, 8)),
        (2, (3, 2, 2)), (2, (4, 3, 3)), (2, (6, 4, 4)),
    ):  # fmt: skip
        model = block(BLOCK, cells, order)
        mass = np.kron(RestSystem(model).mass.toarray(), np.eye(3))
        stiffness = rest_stiffness(model).toarray()
        squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True, subset_by_index=[6, 12])
        error = np.sqrt(squares) / (2.0 * np.pi) * BLOCK[0] / wave_speed / FREE_BLOCK_MODES - 1.0
        worst = error[np.abs(error).argmax()]
        row(model, " x ".join(map(str, cells)), f"{worst:+.2%}", f"{error[0]:+.2%}", f"{np.abs(error).mean():.2%}")


CASES = {"held": held_block, "sphere": held_sphere, "cantilever": cantilever, "modes": modes}

if __name__ == "__main__":
    wp.init()
    for name in sys.argv[1:] or CASES:
        CASES[name]()
