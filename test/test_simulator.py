"""Contact, friction and the step, on blocks with known answers."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

STEP = 1.0 / 200.0
WORLD = np.array([0])
NO_PLATFORM = np.array([-1.0])
PAD_HALF_WIDTH = 0.010
ORDERS = pytest.mark.parametrize("order", [1, 2])
CELLS = {1: (3, 4, 3), 2: (2, 2, 2)}
"""Of a small block, by element order."""

GRIPPER = Gripper(
    name="test",
    pad_half_width=PAD_HALF_WIDTH,
    pad_bottom=-PAD_HALF_WIDTH,
    pad_top=PAD_HALF_WIDTH,
    tip=0.012,
    finger_thickness=0.012,
    max_opening=0.05,
    max_force=100.0,
    hand_to_tcp=0.1,
    closing_speed=0.05,
)


def held_block(
    extents: tuple[float, float, float],
    cells: tuple[int, int, int],
    *,
    youngs_modulus: float = 2e5,
    poissons_ratio: float = 0.3,
    friction: float = 0.7,
    force: float = 1.0,
    worlds: int = 1,
    order: int = 1,
) -> Simulator:
    """A weightless block squeezed along y with the given sum of pad forces."""
    material = Material(youngs_modulus, poissons_ratio, 1000.0, friction)
    model = ObjectModel("block", replace(box(extents, cells), element_order=order), material)
    simulator = Simulator(model, GRIPPER, worlds)
    every = np.arange(worlds)
    grasp = Grasp(np.zeros(3), Rotation.identity().as_quat())
    simulator.set_gravity(every, np.zeros(3))
    simulator.place_gripper(every, [grasp] * worlds, np.full(worlds, extents[1] / 2), np.full(worlds, force))
    for count in range(1, 101):
        closing = np.full(worlds, force * min(1.0, count / 20))
        report = simulator.step(every, STEP, closing, np.full(worlds, NO_PLATFORM[0]), quasi_static=True)
        assert report.converged.all()
    return simulator


def pad_force(simulator: Simulator) -> float:
    return simulator.normal_forces(WORLD)[0, :2].sum()


@ORDERS
@pytest.mark.parametrize("youngs_modulus", [2e4, 2e9])
def test_uniform_squeeze(youngs_modulus, order):
    """Pads larger than the faces, nu = 0: F / A, thickness change F L / (2 E A) and energy are exact on any mesh."""
    width, length, force = 0.016, 0.02, 0.2
    block = held_block(
        (width, length, width),
        CELLS[order],
        youngs_modulus=youngs_modulus,
        poissons_ratio=0.0,
        force=force,
        order=order,
    )
    area = width * width
    pressure = 0.5 * force / area
    assert pad_force(block) == pytest.approx(force, rel=1e-5)
    stress, energy = block.stresses(WORLD)
    np.testing.assert_allclose(stress[0][:, 1, 1], -pressure, rtol=1e-4)
    assert length - 2.0 * block.openings(WORLD)[0] == pytest.approx(pressure * length / youngs_modulus, rel=1e-4)
    assert energy.sum() == pytest.approx(0.5 * pressure**2 / youngs_modulus * area * length, rel=2e-4)


def clamped_block_by_scikit_fem(
    width: float, length: float, cells: int, modulus: float, force: float
) -> tuple[float, float]:
    """Approach of two rigid plates glued to a block's ends and its strain energy, by an independent library.

    Quadratic hexahedra; the plate's approach follows from the reaction to a unit approach.
    """
    skfem = pytest.importorskip("skfem")
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    grid = [np.linspace(-a / 2, a / 2, cells + 1) for a in (width, length, width)]
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*grid), skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    stiffness = linear_elasticity(*lame_parameters(modulus, 0.3)).assemble(basis)
    ends = basis.get_dofs(lambda x: np.abs(np.abs(x[1]) - length / 2) < 1e-9)
    displacement = basis.zeros()
    for side in (-1.0, 1.0):
        plate = basis.get_dofs(lambda x, side=side: np.abs(x[1] - side * length / 2) < 1e-9)
        displacement[plate.all(["u^2"])] = -side / 2
    displacement = skfem.solve(*skfem.condense(stiffness, x=displacement, D=ends.all()))
    reaction = displacement @ (stiffness @ displacement)
    return force / reaction, 0.5 * force**2 / reaction


@pytest.mark.parametrize(("order", "cells", "tolerance"), [(1, (4, 8), 0.01), (2, (2, 4), 0.01)])
def test_sticking_squeeze_converges_to_an_independent_solution(order, cells, tolerance):
    """Rough pads on a nu = 0.3 block: approach and energy tend to those of scikit-fem's glued plates.

    Linear tetrahedra are too stiff by an amount that falls with the square of the cell; the tolerance is on the
    value extrapolated from two meshes, and the refinement itself must bring the error down.
    """
    width, length, modulus, force = 0.018, 0.018, 2e5, 0.05
    approach, energy = clamped_block_by_scikit_fem(width, length, 6, modulus, 0.5 * force)
    measured = []
    for number in cells:
        block = held_block(
            (width, length, width), (number,) * 3, youngs_modulus=modulus, friction=10.0, force=force, order=order
        )
        measured.append((length - 2.0 * block.openings(WORLD)[0], block.stresses(WORLD)[1].sum()))
    coarse, fine = np.array(measured) / [approach, energy]
    assert (np.abs(fine - 1.0) < 0.5 * np.abs(coarse - 1.0)).all()
    np.testing.assert_allclose((4.0 * fine - coarse) / 3.0, 1.0, atol=0.01)


@pytest.mark.parametrize("youngs_modulus", [2e4, 2e9])
def test_slip_begins_at_the_friction_limit_with_order_two(youngs_modulus):
    """A tangential load on a held block is carried up to mu times the sum of the pad forces, and not beyond."""
    friction, force = 0.5, 0.2
    block = held_block(
        (0.016, 0.02, 0.016), (2, 3, 2), youngs_modulus=youngs_modulus, friction=friction, force=force, order=2
    )
    limit = friction * pad_force(block)
    direction = np.array([0.6, 0.0, 0.8])
    touching = np.abs(np.abs(block.model.mesh.vertices[:, 1]) - 0.01) < 1e-9

    def drag(load: float, steps: int) -> float:
        """How far the mean of the gripped nodes moves along the load [m]."""
        start = block.positions(WORLD)[0][touching]
        block.set_gravity(WORLD, load / block.model.mass * direction)
        for _ in range(steps):
            report = block.step(WORLD, STEP, np.array([force]), NO_PLATFORM, quasi_static=True)
            assert report.converged.all()
        return float(((block.positions(WORLD)[0][touching] - start) @ direction).mean())

    for share in np.linspace(0.1, 0.9, 9):
        drag(share * limit, 3)
    drag(0.99 * limit, 150)
    assert abs(drag(0.99 * limit, 20)) < 1e-8
    left, right = block.contact_forces(WORLD)[0].fingers()
    carried = (left.tangential_force + right.tangential_force) @ direction
    assert carried == pytest.approx(-0.99 * limit, rel=1e-4)
    assert drag(1.01 * limit, 20) > 1e-6


def test_pad_corner_in_the_middle_of_a_triangle():
    """A pad smaller than one triangle of the surface still finds it: its corners carry the force."""
    small = Gripper(**{**GRIPPER.__dict__, "pad_half_width": 0.002, "pad_bottom": -0.001, "pad_top": 0.003})
    model = ObjectModel("block", box((0.06, 0.02, 0.06), (3, 2, 3)), Material(2e6))
    simulator = Simulator(model, small, 1)
    grasp = Grasp(np.array([0.003, 0.0, 0.002]), Rotation.identity().as_quat())
    simulator.set_gravity(WORLD, np.zeros(3))
    simulator.place_gripper(WORLD, [grasp], np.array([0.011]), np.array([0.5]))
    for _ in range(60):
        assert simulator.step(WORLD, STEP, np.array([0.5]), NO_PLATFORM, quasi_static=True).converged.all()
    left, right = simulator.contact_forces(WORLD)[0].fingers()
    assert left.count >= 2 and right.count >= 2
    assert left.normal_force + right.normal_force == pytest.approx(0.5, rel=1e-4)


def test_a_broken_world_does_not_disturb_its_neighbours():
    """A world with NaN fails alone, keeps its state, and the others go on as if it were not there."""
    worlds = np.arange(3)
    batch, alone = held_block((0.016, 0.02, 0.016), (3, 3, 3), worlds=3), held_block((0.016, 0.02, 0.016), (3, 3, 3))
    batch.set_velocity(np.array([1]), np.array([np.nan, 0.0, 0.0]))
    forces = batch.normal_forces(worlds)
    for simulator, count in ((batch, 3), (alone, 1)):
        simulator.set_gravity(np.arange(count), np.array([0.0, 0.0, -2.0]))
        report = simulator.step(
            np.arange(count), STEP, np.full(count, 1.0), np.full(count, NO_PLATFORM[0]), quasi_static=False
        )
    assert alone.velocities(WORLD).any() and report.converged.all()
    report = batch.step(worlds, STEP, np.full(3, 1.0), np.full(3, NO_PLATFORM[0]), quasi_static=False)
    alone.step(WORLD, STEP, np.ones(1), NO_PLATFORM, quasi_static=False)
    assert report.converged.tolist() == [True, False, True]
    np.testing.assert_allclose(batch.positions(worlds)[2], alone.positions(WORLD)[0], atol=1e-9)
    np.testing.assert_array_equal(batch.normal_forces(worlds)[1], forces[1])


def test_a_steady_ramp_is_foreseen():
    """Where the answer is linear in the load, the trend of the last step is the next one's solution, nearly."""
    block = held_block((0.016, 0.02, 0.016), (3, 4, 3), poissons_ratio=0.0, force=0.01)
    iterations = []
    for force in np.linspace(0.01, 0.02, 11)[1:]:
        # So slowly that inertia has no part in it: the fingers' rate is that of the force.
        report = block.step(WORLD, STEP, np.array([force]), NO_PLATFORM, quasi_static=True)
        assert report.converged.all()
        iterations.append(int(report.iterations[0]))
    assert max(iterations[3:]) <= 1


def test_trends_do_not_outlast_the_load():
    """A body whose load stops growing rests at once: no drift below the solver's tolerance is carried on."""
    block = held_block((0.016, 0.02, 0.016), (3, 4, 3), force=0.5)
    before = block.positions(WORLD)
    for _ in range(50):
        assert block.step(WORLD, STEP, np.array([0.5]), NO_PLATFORM, quasi_static=False).converged.all()
    assert np.abs(block.positions(WORLD) - before).max() < 1e-8


@ORDERS
@pytest.mark.parametrize(("load", "crushed"), [(0.9, False), (1.1, True)])
def test_a_crushed_block_is_marked(order, load, crushed):
    """With nu = 0 a block between larger pads has the stretch 1 - F / (2 E A): at F = 2 E A it turns inside out."""
    width, modulus = 0.016, 2e4
    force = load * 2.0 * modulus * width**2
    block = held_block((width, 0.02, width), CELLS[order], youngs_modulus=modulus, poissons_ratio=0.0, order=order)
    for share in np.linspace(0.0, 1.0, 81)[1:]:
        closing = np.array([max(1.0, share * force)])
        report = block.step(WORLD, STEP, closing, NO_PLATFORM, quasi_static=True)
        if report.crushed.any():
            break
        assert report.usable.all()
    assert report.crushed.all() == crushed and report.usable.all() != crushed


LOADED_BY_THREADS = """
import dataclasses, os, threading
import numpy as np
import warp as wp
from warp._src.context import Module
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator
from test_simulator import GRIPPER

wp.config.quiet = True
load = Module.load

def watched_load(self, *arguments, **options):
    known = len(self.execs)
    result = load(self, *arguments, **options)
    if len(self.execs) != known and threading.current_thread() is not threading.main_thread():
        print(self.name)
    return result

Module.load = watched_load
os.sched_getaffinity = lambda process: {0, 1}
for order in (1, 2):
    mesh = dataclasses.replace(box((0.02, 0.02, 0.02), (1, 1, 1)), element_order=order)
    simulator = Simulator(ObjectModel("cube", mesh, Material()), GRIPPER, 2)
    assert len(simulator._shards) == 2
    simulator.step(np.arange(2), 0.005, np.zeros(2), np.full(2, -0.01), quasi_static=False)
"""


def test_threads_find_all_kernels_loaded():
    """A thread loads none itself: of two that do so at once, one would be left without its code."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, "-c", LOADED_BY_THREADS], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout == ""
