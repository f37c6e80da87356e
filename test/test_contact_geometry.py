"""Rounded pads and the palm against deformable blocks: where they touch, and how that depends on the mesh.

The gap between surface and pad is measured here by sampling the triangles densely, with the formula of a rounded
edge written down anew; nothing of the search for contacts is used.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper, Palm
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

STEP = 1.0 / 200.0
WORLD = np.array([0])
NO_PLATFORM = np.array([-1.0])
ROUNDED = Gripper(
    name="rounded",
    pad_half_width=0.0035,
    pad_bottom=-0.004,
    pad_top=0.003,
    tip=0.006,
    finger_thickness=0.012,
    max_opening=0.05,
    max_force=100.0,
    hand_to_tcp=0.1,
    closing_speed=0.05,
    side_fillet=0.002,
    tip_fillet=0.003,
)
SHARP = replace(ROUNDED, side_fillet=0.0, tip_fillet=0.0)
LONG = replace(ROUNDED, pad_half_width=0.003, pad_bottom=-0.02, pad_top=0.02, tip=0.03, tip_fillet=0.0)
EXTENTS = np.array([0.024, 0.016, 0.024])


def squeezed(
    gripper: Gripper,
    mesh: TetMesh,
    force: float,
    position=(0.0, 0.0, 0.0),
    angle: float = 0.0,
    friction: float = 0.7,
    steps: int = 10,
) -> tuple[Simulator, np.ndarray]:
    """A weightless block squeezed along y to the given sum of pad forces; with its approach after each step [m]."""
    simulator = Simulator(ObjectModel("block", mesh, Material(2e5, 0.3, 1000.0, friction)), gripper, 1)
    grasp = Grasp(np.array(position), Rotation.from_euler("y", angle).as_quat())
    simulator.set_gravity(WORLD, np.zeros(3))
    start = 0.5 * mesh.extents[1]
    simulator.place_gripper(WORLD, [grasp], np.array([start]), np.array([force]))
    approach = []
    for count in range(1, 3 * steps + 1):
        closing = np.array([force * min(1.0, count / steps)])
        assert simulator.step(WORLD, STEP, closing, NO_PLATFORM, quasi_static=True).converged.all()
        approach.append(2.0 * (start - simulator.openings(WORLD)[0]))
    return simulator, np.array(approach)


def sampled_gaps(gripper: Gripper, grasp: Grasp, simulator: Simulator, per_edge: int) -> list[np.ndarray]:
    """Height of dense points of the surface over each pad at opening 0, along the closing axis [m].

    Those in front of the pad and not behind it, with fillets measured by the circles they are.
    """
    corners = simulator.positions(WORLD)[0][simulator.model.mesh.surface_triangles]
    weights = [(i, j, per_edge - i - j) for i in range(per_edge + 1) for j in range(per_edge + 1 - i)]
    points = np.einsum("pk,tkj->tpj", np.array(weights) / per_edge, corners).reshape(-1, 3)
    x, y, z = ((points - grasp.position) @ grasp.rotation).T
    within = (np.abs(x) <= gripper.pad_half_width + gripper.side_fillet) & (z >= gripper.pad_bottom)
    within &= z <= gripper.pad_top + gripper.tip_fillet
    heights = []
    for side in (1.0, -1.0):
        chosen = within & (side * y > 0.0)
        beyond_side = np.maximum(np.abs(x[chosen]) - gripper.pad_half_width, 0.0)
        beyond_tip = np.maximum(z[chosen] - gripper.pad_top, 0.0)
        round_off = gripper.side_fillet - np.sqrt(np.maximum(gripper.side_fillet**2 - beyond_side**2, 0.0))
        round_off += gripper.tip_fillet - np.sqrt(np.maximum(gripper.tip_fillet**2 - beyond_tip**2, 0.0))
        heights.append(round_off - side * y[chosen])
    return heights


def deepest(simulator: Simulator, position, angle: float = 0.0) -> float:
    """Largest depth of the surface in a pad, along the closing axis, relative to the object's size [-]."""
    grasp = Grasp(np.array(position), Rotation.from_euler("y", angle).as_quat())
    heights = np.concatenate(sampled_gaps(simulator.gripper, grasp, simulator, per_edge=40))
    return -(heights.min() + simulator.openings(WORLD)[0]) / simulator.model.mesh.size


@pytest.mark.parametrize("seed", range(12))
def test_first_touch_is_where_dense_samples_say(seed):
    """A turned coarse block before a small pad: nodes, edges and triangles together give the smallest gap."""
    random = np.random.default_rng(seed)
    mesh = box((0.03, 0.02, 0.03), (2, 2, 2))
    turned = TetMesh(mesh.vertices @ Rotation.random(random_state=seed).as_matrix().T, mesh.tetrahedra)
    gripper = ROUNDED if seed % 3 else SHARP
    simulator = Simulator(ObjectModel("block", turned, Material()), gripper, 1)
    grasp = Grasp(random.uniform(-0.008, 0.008, 3), Rotation.from_euler("y", random.uniform(0, 6)).as_quat())
    simulator.place_gripper(WORLD, [grasp], np.array([0.05]), np.ones(1))
    found = simulator.pad_gaps(WORLD)[0]
    sampled = [0.05 + heights.min(initial=np.inf) for heights in sampled_gaps(gripper, grasp, simulator, 300)]
    # Samples are 0.1 mm apart, on slopes of up to 2 at sharp edges; they can only lie further away.
    assert (found <= np.array(sampled) + 1e-9).all()
    np.testing.assert_allclose(found, sampled, atol=2e-4)


SPOTS = {
    "amid triangles": ((0.0007, 0.0, 0.0004), 0.0),
    "turned": ((0.0007, 0.0, 0.0004), 0.3),
    "half off the side": ((0.0113, 0.0, 0.0004), 0.0),
    "tip only": ((0.0007, 0.0, -0.0118), 0.0),
}


@pytest.mark.parametrize("spot", SPOTS)
@pytest.mark.parametrize("gripper", [ROUNDED, SHARP], ids=["rounded", "sharp"])
def test_nothing_penetrates_a_pad(spot, gripper):
    """A pad smaller than a triangle, and one half off the block, on three meshes: no point of the surface inside.

    A unit force presses the pads 0.1 to 0.5 mm, 3e-3 to 1e-2 of the size, into the block; what is left inside is
    below 1e-4. The closing force balances the pads' forces along the closing axis, tilted normals included.
    """
    position, angle = SPOTS[spot]
    for cells in ((3, 2, 3), (6, 4, 6), (9, 6, 9)):
        block, approach = squeezed(gripper, box(EXTENTS, cells), 1.0, position, angle)
        assert approach[-1] > 1e-4
        assert deepest(block, position, angle) < 1e-4
        forces = block.contact_forces(WORLD)[0]
        along_axis = [np.sum(forces.forces[forces.body == pad, 1]) for pad in (0, 1)]
        assert along_axis[1] - along_axis[0] == pytest.approx(1.0, rel=1e-4)


def test_normals_follow_the_fillet():
    """A block held by its edge in the side fillet: forces lie along the normals of the arc, within the cone."""
    block, _ = squeezed(ROUNDED, box(EXTENTS, (6, 4, 6)), 1.0, (0.0113 + 0.004, 0.0, 0.0))
    forces = block.contact_forces(WORLD)[0]
    x = forces.positions[:, 0] - 0.0153
    beyond = np.clip(np.abs(x) - ROUNDED.pad_half_width, 0.0, None) / ROUNDED.side_fillet
    assert beyond.max() > 0.05
    np.testing.assert_allclose(np.abs(forces.normals[:, 0]), beyond, atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(forces.normals, axis=1), 1.0)
    assert (np.einsum("ij,ij->i", forces.normals, forces.forces) > 0.0).all()


def test_points_are_listed_once_in_order():
    """Keys ascend, so each occurs once; no two points of a body nearly coincide."""
    block, _ = squeezed(ROUNDED, box(EXTENTS, (6, 4, 6)), 1.0, *SPOTS["turned"])
    lists = block._shards[0].contacts.lists
    count = lists.count.numpy()[0]
    keys, bodies = lists.key.numpy()[0, :count], lists.body.numpy()[0, :count]
    assert count > 10 and (np.diff(keys) > 0).all()
    nodes, weights = lists.nodes.numpy()[0, :count], lists.weights.numpy()[0, :count]
    dense = np.zeros((count, len(block.model.mesh.vertices)))
    np.add.at(dense, (np.arange(count)[:, None], nodes), weights)
    for a, b in itertools.combinations(range(count), 2):
        assert bodies[a] != bodies[b] or np.abs(dense[a] - dense[b]).max() > 0.05


def rounded_punch_by_scikit_fem(extents, gripper: Gripper, modulus: float, depth: float, cells) -> float:
    """Force with which a long rounded pad, pressed ``depth`` into both sides of a block without friction, resists.

    An independent path: quadratic hexahedra, small strain, gaps at their nodes along the arc's normals, active set.
    """
    skfem = pytest.importorskip("skfem")
    import scipy.sparse as sparse
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    length, height, width = extents
    limits = ((-length / 2, length / 2), (0.0, height / 2), (-width / 2, width / 2))
    grid = [np.linspace(*limit, n + 1) for limit, n in zip(limits, cells, strict=True)]
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*grid), skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    stiffness = linear_elasticity(*lame_parameters(modulus, 0.3)).assemble(basis)
    place, axis = basis.doflocs, np.zeros(basis.N, dtype=int)
    for k in range(3):
        for dofs in (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs):
            axis[dofs[k]] = k
    free = np.flatnonzero((axis != 1) | (place[1] > 1e-9))  # y = 0 is the plane of symmetry
    pinned = stiffness + sparse.diags(np.where(axis == 1, 0.0, 1e-6 * modulus * length / basis.N))
    top = place[1] > height / 2 - 1e-9
    touched = top & (np.abs(place[0]) < gripper.pad_half_width + 0.9 * gripper.side_fillet)
    across, down = (np.flatnonzero(touched & (axis == k)) for k in (0, 1))
    across, down = (dofs[np.lexsort(np.round(place[::2, dofs], 9))] for dofs in (across, down))
    x = place[0, down]
    sine = np.sign(x) * np.maximum(np.abs(x) - gripper.pad_half_width, 0.0) / gripper.side_fillet
    cosine = np.sqrt(1.0 - sine**2)
    rows, number = np.arange(len(down)), np.empty(basis.N, dtype=int)
    number[free] = np.arange(len(free))
    normal = np.zeros((len(down), len(free)))
    normal[rows, number[down]], normal[rows, number[across]] = -cosine, sine
    compliance = normal @ sparse.linalg.splu(pinned[free][:, free].tocsc()).solve(normal.T)
    gap = (gripper.side_fillet * (1.0 - cosine) - depth) * cosine
    active = gap < 0.0
    for _ in range(50):
        force = np.zeros(len(gap))
        force[active] = np.linalg.solve(compliance[np.ix_(active, active)], -gap[active])
        pressed = np.where(active, force > 0.0, compliance @ force + gap < 0.0)
        if (pressed == active).all():
            return float(force @ cosine)
        active = pressed
    raise AssertionError("the active set does not settle")


def test_rounded_punch_converges_to_an_independent_solution():
    """Approach under a rounded pad tends to that of quadratic hexahedra with the same pad.

    The pad's edge lies on nodes of both meshes, where the error is of first order in the cell: linear tetrahedra are
    too stiff, and an edge that touches at two points stays straight between them. Halving the cell about halves the
    error; the tolerance is on the value extrapolated.
    """
    extents, depth = (0.024, 0.012, 0.001), 6e-5
    force = rounded_punch_by_scikit_fem(extents, LONG, 2e5, depth, (24, 6, 1))
    shares = []
    for cells in ((16, 8, 1), (32, 16, 1)):
        _, approach = squeezed(LONG, box(extents, cells), 2.0 * force, friction=1e-6)
        shares.append(approach[-1] / (2.0 * depth))
    coarse, fine = shares
    assert 1.0 - fine < 0.6 * (1.0 - coarse)
    assert 2.0 * fine - coarse == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("spot", ["amid triangles", "half off the side"])
def test_approach_and_pressed_area_settle_with_the_mesh(spot):
    """Three meshes: approach and extent of the contact change less with each refinement."""
    position, angle = SPOTS[spot]
    measured = []
    for cells in ((4, 3, 4), (8, 5, 8), (12, 8, 12)):
        block, approach = squeezed(ROUNDED, box(EXTENTS, cells), 1.0, position, angle)
        forces = block.contact_forces(WORLD)[0]
        mine = forces.positions[forces.body == 0]
        measured.append([approach[10], approach[-1], np.ptp(mine[:, 0]) * np.ptp(mine[:, 2])])
    first, second = np.abs(np.diff(measured, axis=0))
    assert (second < first + 0.05 * np.abs(measured[-1])).all()


def test_the_palm_carries_what_falls_on_it():
    """A block dropped on the palm of a hand that points up rests there; beside it, it falls through."""
    gripper = replace(ROUNDED, palm=Palm(face=-0.02, half_width=0.02, half_length=0.02))
    model = ObjectModel("block", box((0.01, 0.01, 0.01), (2, 2, 2)), Material(2e5))
    for shift, carried in ((0.0, 1.0), (0.04, 0.0)):
        simulator = Simulator(model, gripper, 1)
        grasp = Grasp(np.array([shift, 0.0, 0.015]), Rotation.identity().as_quat())
        simulator.place_gripper(WORLD, [grasp], np.array([0.05]), np.ones(1))
        for _ in range(40):
            assert simulator.step(WORLD, STEP, np.zeros(1), NO_PLATFORM, quasi_static=True).converged.all()
        assert simulator.normal_forces(WORLD)[0, 3] == pytest.approx(carried * model.weight, abs=1e-4 * model.weight)
        assert (simulator.positions(WORLD)[0][:, 2].min() > -0.0051) == bool(carried)


def test_a_node_on_the_edge_counts_as_inside():
    """A node beyond a pad's edge by less than a hair is a contact point itself, as strain may move it to and fro."""
    edge = SHARP.pad_half_width
    mesh = box((4.0 * edge, 0.01, 0.012), (4, 3, 4))
    for shift, inside in ((1e-9, True), (1e-5, False)):
        simulator, _ = squeezed(SHARP, mesh, 1e-4, position=(shift, 0.0, 0.0))
        forces = simulator.contact_forces(WORLD)[0]
        on_edge = np.abs(forces.positions[:, 0] + edge) < 1e-4
        assert on_edge.any()
        assert (forces.weights[on_edge].max(axis=1) == 1.0).any() == inside


@pytest.mark.parametrize(("height", "meets"), [(0.002, True), (-0.004, False)])
def test_a_wall_is_no_contact_surface(height, meets):
    """What flies in over the edge of a face meets it; what comes in through the wall behind goes on undisturbed.

    ``height`` is that of the block's lower side over the face of the left pad.
    """
    block = box((0.01, 0.01, 0.01), (3, 3, 3))
    simulator = Simulator(ObjectModel("block", block, Material(2e5)), SHARP, 1)
    simulator.set_gravity(WORLD, np.zeros(3))
    grasp = Grasp(np.zeros(3), Rotation.identity().as_quat())
    simulator.place_gripper(WORLD, [grasp], np.array([SHARP.max_opening]), np.array([1.0]))
    # The left pad's face looks along -y; the block begins 1 mm beside its edge, along x.
    start = np.array([SHARP.pad_half_width + 0.006, SHARP.max_opening - 0.005 - height, 0.0])
    velocity = np.array([-0.5, 0.1 if meets else 0.0, 0.0])
    simulator.set_displacement(WORLD, np.broadcast_to(start, block.vertices.shape))
    simulator.set_velocity(WORLD, velocity)
    simulator.freeze_fingers(WORLD)
    steps, h = 50, 1e-3
    touched = False
    for _ in range(steps):
        assert simulator.step(WORLD, h, np.zeros(1), NO_PLATFORM, quasi_static=False).converged.all()
        touched |= simulator.normal_forces(WORLD)[0, 0] > 0.0
    assert touched == meets
    free = block.vertices + start + steps * h * velocity
    assert (np.abs(simulator.positions(WORLD)[0] - free).max() < 1e-9) != meets


def refined_at_the_edge(extents, edge: float, cell: float) -> TetMesh:
    """A block with cells of that size at x = +-edge and at its faces +-y, growing away from there."""
    away = np.concatenate([[0.0], np.cumsum(cell * 1.6 ** np.arange(20))])
    end, face = extents[0] / 2.0, extents[1] / 2.0
    across = np.concatenate([edge + away[edge + away < 0.95 * end], edge - away[edge - away > 0.1 * edge], [0.0, end]])
    down = np.concatenate([face - away[away < 0.9 * face], [0.0]])
    x, y = (np.unique(np.round(np.concatenate([-half, half]), 9)) for half in (across, down))
    mesh = box(extents, (len(x) - 1, len(y) - 1, 1))
    vertices = mesh.vertices.copy()
    for axis, coordinates in ((0, x), (1, y)):
        number = np.rint((vertices[:, axis] / extents[axis] + 0.5) * (len(coordinates) - 1)).astype(int)
        vertices[:, axis] = coordinates[number]
    return TetMesh(vertices, mesh.tetrahedra)


def peak_stress(gripper: Gripper, cell: float) -> float:
    """Largest von Mises stress of a block squeezed by 5 % under long pads [Pa]."""
    block, _ = squeezed(gripper, refined_at_the_edge((0.024, 0.012, 0.001), gripper.pad_half_width, cell), 0.1)
    stress = block.stresses(WORLD)[0][0]
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    return float(np.sqrt(1.5 * np.einsum("tij,tij->t", deviator, deviator)).max())


def test_a_fillet_takes_the_peak_off_the_edge():
    """Under a sharp edge the stress grows like a singularity, by 3/2 with each halving; under a fillet it settles."""
    cells = (6e-4, 3e-4, 1.5e-4)
    sharp, rounded = (
        np.array([peak_stress(gripper, cell) for cell in cells]) for gripper in (replace(LONG, side_fillet=0.0), LONG)
    )
    assert (sharp[1:] > 1.3 * sharp[:-1]).all()
    assert (rounded[1:] < 1.25 * rounded[:-1]).all()
    assert sharp[-1] > 2.0 * rounded[-1]
