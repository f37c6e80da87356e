"""Samplers of candidate grasps, checked with an independent ray caster."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from defgrasp_ros.errors import EmptyGraspListError, InvalidOptionsError
from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.box_overlap import triangles_meeting_box
from defgrasp_ros.mesh.rays import RayCaster
from defgrasp_ros.mesh.shapes import kidney_surface
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.objects import find_object
from defgrasp_ros.sampling import SAMPLERS, Fit, HandFit, antipodal_grasps, sample_grasps
from defgrasp_ros.sampling.antipodal import DEFAULT_CONE
from defgrasp_ros.sampling.clearance import finger_boxes, palm_box
from defgrasp_ros.sampling.detail import with_fewer_triangles
from defgrasp_ros.sampling.diversity import farthest_first
from defgrasp_ros.sampling.rotations import GRID_SIZES, healpix_directions, rotation_grid

HAND = load_gripper()


@pytest.fixture(scope="module")
def kidney():
    return trimesh.Trimesh(*kidney_surface(), process=False)


def test_rays_agree_with_trimesh(kidney):
    """All crossings of rays with a curved surface are those that trimesh finds."""
    random = np.random.default_rng(0)
    origins = random.uniform(*(1.5 * kidney.bounds), (200, 3))
    directions = random.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = RayCaster(kidney.vertices, kidney.faces).cast(origins, directions)
    triangles, rays = kidney.ray.intersects_id(origins, directions, multiple_hits=True)
    assert len(hits.ray) > 50
    assert set(zip(hits.ray, hits.triangle, strict=True)) == set(zip(rays, triangles, strict=True))
    points = origins[hits.ray] + hits.distance[:, None] * directions[hits.ray]
    corners = kidney.triangles[hits.triangle]
    assert np.abs(np.einsum("ij,ij->i", points - corners[:, 0], kidney.face_normals[hits.triangle])).max() < 1e-12
    assert trimesh.triangles.points_to_barycentric(corners, points).min() > -1e-9


def test_points_inside_are_found(kidney):
    """Whether a point is inside agrees with its signed distance."""
    points = np.random.default_rng(1).uniform(*kidney.bounds, (300, 3))
    distance = trimesh.proximity.signed_distance(kidney, points)
    inside = RayCaster(kidney.vertices, kidney.faces).contains(points)
    assert 50 < inside.sum() < 250
    assert np.array_equal(inside, distance > 0.0)


def test_box_overlap_agrees_with_clipping():
    """A triangle meets a box exactly if something of it is left when it is cut at the six planes of the box."""
    random = np.random.default_rng(2)
    low, high = np.array([-0.5, -0.4, -0.2]), np.array([0.5, 0.3, 0.4])
    corners = random.normal(size=(2000, 1, 3)) * 0.6 + random.normal(size=(2000, 3, 3)) * 0.4
    corners[:3] = [[[x, -9.0, -9.0], [x, 9.0, -9.0], [x, 0.0, 9.0]] for x in (0.49, 0.51, 0.0)]
    found = triangles_meeting_box(corners, low, high)
    planes = [*zip(low * np.eye(3), np.eye(3), strict=True), *zip(high * np.eye(3), -np.eye(3), strict=True)]
    for triangle, meets in zip(corners, found, strict=True):
        polygon = list(triangle)
        for origin, normal in planes:
            heights = [normal @ (point - origin) for point in polygon]
            cut = []
            for i, (point, height) in enumerate(zip(polygon, heights, strict=True)):
                if height * heights[i - 1] < 0.0:
                    cut.append(polygon[i - 1] + (point - polygon[i - 1]) * heights[i - 1] / (heights[i - 1] - height))
                if height > 0.0:
                    cut.append(point)
            polygon = cut
        assert bool(polygon) == meets
    assert 200 < found.sum() < 1800


def test_antipodal_contacts_face_each_other(kidney):
    """Contacts lie on the surface, on the closing axis, within the pads and the cone, and the grasp is between them."""
    max_angle = 0.3
    found = antipodal_grasps(kidney.vertices, kidney.faces, HAND, 30, max_angle=max_angle, standoff=0.001, seed=3)
    assert len(found) == 30
    for candidate in found:
        local = (candidate.contacts - candidate.grasp.position) @ candidate.grasp.rotation
        half = candidate.width / 2.0
        np.testing.assert_allclose(local, [[0.0, half, 0.001], [0.0, -half, 0.001]], atol=1e-9)
        assert candidate.width < 2.0 * HAND.max_opening
        _, distance, triangles = trimesh.proximity.closest_point(kidney, candidate.contacts)
        assert distance.max() < 2e-5  # trimesh takes points near an edge to be on it
        closing = candidate.grasp.rotation[:, 1]
        angles = np.arccos(np.einsum("ij,ij->i", [closing, -closing], kidney.face_normals[triangles]))
        assert angles.max() <= max_angle + 1e-6
        assert candidate.angle == pytest.approx(angles.max(), abs=1e-6)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_no_sampled_hand_is_inside_the_object(kidney, sampler):
    """No point of palm or fingers lies inside; something lies between the pads; the same seed repeats."""
    grasps = sample_grasps(kidney.vertices, kidney.faces, HAND, 8, sampler=sampler, seed=5)
    assert len(grasps) == 8
    again = sample_grasps(kidney.vertices, kidney.faces, HAND, 8, sampler=sampler, seed=5)
    assert [g.position.tolist() for g in grasps] == [g.position.tolist() for g in again]
    random = np.random.default_rng(0)
    for grasp in grasps:
        boxes = [*finger_boxes(HAND, HAND.max_opening), palm_box(HAND)]
        points = np.concatenate([random.uniform(low, high, (300, 3)) for low, high in boxes])
        assert not kidney.contains(grasp.position + points @ grasp.rotation.T).any()
        local = (kidney.vertices - grasp.position) @ grasp.rotation
        between = np.abs(local[:, 1]) < HAND.max_opening
        in_front = (local[:, 2] > HAND.pad_bottom) & (local[:, 2] < HAND.pad_top)
        assert (between & in_front).any()


@pytest.mark.parametrize(
    ("height", "expected"),
    [(0.0, Fit.FREE), (-0.1, Fit.PALM_COLLISION), (0.2, Fit.EMPTY)],
)
def test_fit_of_a_hand_from_above(height, expected):
    """Around a 40 mm cube the hand is free; pushed down the palm hits it; far above nothing is between the pads."""
    cube = trimesh.creation.box([0.04, 0.04, 0.04])
    down = np.diag([1.0, -1.0, -1.0])
    fit = HandFit(cube.vertices, cube.faces, HAND)
    assert fit.check(np.array([0.0, 0.0, height]), down) is expected


def test_hand_without_palm_collides_with_its_fingers_alone():
    """Where no palm is described, nothing is between the fingers that could touch."""
    cube = trimesh.creation.box([0.04, 0.04, 0.04])
    down = np.diag([1.0, -1.0, -1.0])
    fit = HandFit(cube.vertices, cube.faces, replace(HAND, palm=None))
    assert fit.check(np.array([0.0, 0.0, -0.05]), down) is Fit.FREE
    assert HandFit(cube.vertices, cube.faces, HAND).check(np.array([0.0, 0.0, -0.05]), down) is Fit.PALM_COLLISION


def test_finger_and_swallowed_finger_are_collisions():
    """A finger that touches the surface collides, and so does one that is wholly inside a large body."""
    down = np.diag([1.0, -1.0, -1.0])
    cube = trimesh.creation.box([0.04, 0.04, 0.04])
    assert HandFit(cube.vertices, cube.faces, HAND).check(np.array([0.0, 0.04, 0.0]), down) is Fit.FINGER_COLLISION
    large = trimesh.creation.box([1.0, 1.0, 1.0])
    assert HandFit(large.vertices, large.faces, HAND).check(np.zeros(3), down) in (Fit.FINGER_COLLISION, Fit.EMPTY)
    wall = trimesh.util.concatenate([large, cube])
    assert HandFit(wall.vertices, wall.faces, HAND).check(np.zeros(3), down) is Fit.FINGER_COLLISION


def test_nothing_to_hold_says_why():
    """An object wider than the gripper opens has no grasp, and the text gives the reason."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    with pytest.raises(EmptyGraspListError, match="wider than the gripper opens"):
        antipodal_grasps(ball.vertices, ball.faces, HAND, 2)


def test_options_out_of_range_are_named(kidney):
    """Each number names itself."""
    for option, value in {"count": 0, "max_angle": 2.0, "standoff": 0.1, "seed": -1, "sampler": "lucky"}.items():
        arguments = {"count": 1, option: value}
        with pytest.raises(InvalidOptionsError, match=option):
            sample_grasps(kidney.vertices, kidney.faces, HAND, **arguments)


def test_farthest_first_knows_that_fingers_are_alike():
    """Of four poses, the one that only exchanges the fingers is chosen last."""
    turn = np.diag([-1.0, -1.0, 1.0])
    other = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotations = np.stack([np.eye(3), turn, other, np.eye(3)])
    positions = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [0.1, 0, 0]])
    order = farthest_first(positions, rotations, 9)
    assert order[0] == 0 and order[-1] == 1 and len(order) == 4


def test_rotation_grids_are_even():
    """HEALPix directions balance out; each rotation of the finer grid has its neighbour about 30 deg away."""
    polar, azimuth = healpix_directions(4)
    assert len(polar) == 12 * 16
    directions = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cov(directions.T, bias=True), np.eye(3) / 3.0, atol=0.005)
    for size, spacing in zip(GRID_SIZES[:2], (60.0, 30.0), strict=True):
        grid = rotation_grid(size)
        assert len(grid) == size
        angles = np.degrees((grid[0].inv() * grid[1:]).magnitude())
        assert 0.6 * spacing < angles.min() < 1.3 * spacing


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ellipsoid", "cube", "annulus", "cup", "bottle", "banana", "strawberry", "kidney"])
@pytest.mark.parametrize("gripper", ["franka_hand", "robotiq_2f_85"])
def test_fifty_grasps_on_objects_of_all_kinds(name, gripper):
    """No palm or finger is inside, both pads reach the surface, and the contacts are within the cone."""
    hand = load_gripper(gripper)
    surface = trimesh.Trimesh(*with_fewer_triangles(*find_object(name).surface()), process=False)
    found = antipodal_grasps(surface.vertices, surface.faces, hand, 50, seed=1)
    assert len(found) == 50
    random = np.random.default_rng(0)
    for candidate in found:
        grasp, closing = candidate.grasp, candidate.grasp.rotation[:, 1]
        boxes = [*finger_boxes(hand, hand.max_opening), palm_box(hand)]
        points = np.concatenate([random.uniform(low, high, (60, 3)) for low, high in boxes])
        assert not surface.contains(grasp.position + points @ grasp.rotation.T).any()
        starts = grasp.position + hand.max_opening * np.stack([closing, -closing])
        hits, rays, triangles = surface.ray.intersects_location(starts, [-closing, closing], multiple_hits=False)
        assert set(rays) == {0, 1}
        assert (np.linalg.norm(hits - starts[rays], axis=1) < hand.max_opening).all()
        assert candidate.angle <= DEFAULT_CONE + 1e-9


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["ellipsoid", "cube", "cylinder", "potato"])
def test_most_sampled_grasps_hold(name):
    """At E = 2e5 Pa, at least 60 % of the grasps on a compact convex object pick it up."""
    entry = find_object(name)
    grasps = sample_grasps(*with_fewer_triangles(*entry.surface()), HAND, 8, seed=2)
    model = ObjectModel(name, entry.mesh(0.01, element_order=1), Material(youngs_modulus=2e5))
    evaluations = evaluate_grasps(model, grasps, HAND, EvaluationOptions(pickup_hold_time=0.5))
    assert sum(evaluation.metrics.pickup_success for evaluation in evaluations) >= 0.6 * len(grasps)
