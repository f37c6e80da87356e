"""The pictures of grasps, and the renderer below them."""

import numpy as np
import pytest
from matplotlib.image import imread

from defgrasp_ros.drawing.evaluated_grasps import draw_evaluation, draw_evaluations
from defgrasp_ros.drawing.rendering import Camera, compose, solid
from defgrasp_ros.drawing.scene import Scene, finger_surface
from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import DeformedState, FingerContact, GraspEvaluation, GraspMetrics
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel

RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
FROM_ABOVE = [1.0, 0.0, 0.0, 0.0]
EXTENTS = np.array([0.06, 0.03, 0.02])


@pytest.fixture(scope="module")
def model():
    return ObjectModel("block", box(EXTENTS, (6, 3, 2)), Material())


def held(model, grasp):
    """An evaluation with made-up fields: a stress that grows with x, and one contact at each side."""
    contacts = tuple(
        FingerContact(
            name,
            positions=np.array([[0.0, side * EXTENTS[1] / 2.0, 0.0]]),
            normals=np.array([[0.0, -side, 0.0]]),
            forces=np.array([[0.0, -side * 2.0, 0.5]]),
        )
        for name, side in (("left_finger", 1.0), ("right_finger", -1.0))
    )
    centres = model.mesh.vertices[model.mesh.tetrahedra].mean(axis=1)
    state = DeformedState(model.mesh.vertices, 1e3 * (centres[:, 0] + 0.03), opening=EXTENTS[1] / 2.0)
    metrics = GraspMetrics(True, 60.0, 1e-3, 1e-5)
    return GraspEvaluation(0, grasp.id, metrics=metrics, contacts=contacts, fields={"post_pickup": state})


def missed(grasp):
    return GraspEvaluation(1, grasp.id, code=ResultCode.NO_CONTACT, message="the object is not between the pads")


def saturated_fraction(image):
    """Share of pixels with a clear hue: the colours of stress, forces and axes, but no grey."""
    return float((np.ptp(image[..., :3], axis=-1) > 0.25).mean())


def cuboid(low, high):
    mesh = box(np.subtract(high, low), (1, 1, 1))
    return mesh.vertices + np.add(low, high) / 2.0, mesh.surface_triangles


def test_camera_sees_z_up_and_the_nearer_side():
    """From the +x side, y runs to the right, z up, and +x comes towards the viewer."""
    camera = Camera.around(np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]), azimuth=0.0, elevation=0.0, shape=(10, 10))
    np.testing.assert_allclose(camera.rotation @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(camera.rotation @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(camera.rotation @ [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], atol=1e-15)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)


def test_silhouette_has_the_right_size_and_place():
    """A 2 x 1 rectangle in a picture of 4 x 4 covers an eighth of it, in the middle."""
    camera = Camera(np.zeros(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 2.0, (200, 200))
    layer = solid(camera, *cuboid([-1.0, -1.0, -0.5], [1.0, 1.0, 0.5]), RED)
    rows, columns = np.nonzero(layer.mask)
    assert layer.mask.mean() == pytest.approx(2.0 * 1.0 / 16.0, rel=0.03)
    assert (rows.min(), rows.max()) == (75, 124) and (columns.min(), columns.max()) == (50, 149)
    np.testing.assert_allclose(layer.depth[layer.mask], 1.0)


def test_what_is_nearer_hides_what_is_behind():
    """The order of the layers does not matter, the depth of each pixel does; translucent layers mix."""
    camera = Camera(np.zeros(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 2.0, (40, 40))
    near = cuboid([0.5, -1.0, -1.0], [1.0, 1.0, 1.0])
    far = cuboid([-1.0, -1.5, -1.5], [-0.5, 1.5, 1.5])
    layers = [solid(camera, *near, RED), solid(camera, *far, BLUE)]
    for ordered in (layers, layers[::-1]):
        image = compose(ordered, np.ones(3), softness=1.0)
        assert image[20, 20, 0] > 0.5 > image[20, 20, 2]
        assert image[20, 7, 2] > 0.5 > image[20, 7, 0]
        np.testing.assert_allclose(image[0, 0], 1.0)
    mixed = compose([solid(camera, *near, RED, opacity=0.5), solid(camera, *far, BLUE)], np.ones(3), softness=1.0)
    assert mixed[20, 20, 0] == pytest.approx(mixed[20, 20, 2], rel=0.3)


def test_fingers_stand_where_the_gripper_says(model):
    """Pad faces are an opening away from the grasp's origin along its y axis, the tips ahead of it along z."""
    gripper = load_gripper()
    grasp = Grasp([0.01, 0.02, 0.03], FROM_ABOVE)
    left, right = (
        (corners - grasp.position) @ grasp.rotation
        for corners in Scene.of_evaluation(model, gripper, grasp, held(model, grasp)).fingers
    )
    assert left[:, 1].min() == pytest.approx(EXTENTS[1] / 2.0)
    assert left[:, 1].max() == pytest.approx(EXTENTS[1] / 2.0 + gripper.finger_thickness)
    assert right[:, 1].max() == pytest.approx(-EXTENTS[1] / 2.0)
    for finger in (left, right):
        assert (finger[:, 2].min(), finger[:, 2].max()) == pytest.approx((gripper.pad_bottom, gripper.tip))
        assert np.ptp(finger[:, 0]) == pytest.approx(2.0 * gripper.finger_half_width)
    open_left = Scene.of_evaluation(model, gripper, grasp, missed(grasp)).fingers[0] @ grasp.rotation
    assert open_left[:, 1].min() - (grasp.position @ grasp.rotation)[1] == pytest.approx(gripper.max_opening)


def test_fingers_are_closed_and_rounded():
    """The drawn finger is a closed block, its fillets cut off a little less than their corners' prisms."""
    import trimesh

    gripper = load_gripper()
    finger = trimesh.Trimesh(*finger_surface(gripper))
    length, width = gripper.tip - gripper.pad_bottom, 2.0 * gripper.finger_half_width
    cut = (1.0 - np.pi / 4.0) * (2.0 * gripper.side_fillet**2 * length + gripper.tip_fillet**2 * width)
    assert finger.is_watertight
    assert finger.volume == pytest.approx(gripper.finger_thickness * width * length - cut, rel=2e-3)


def test_nodal_stress_is_a_mean_of_elements(model):
    """A uniform stress stays as it is; the platform is drawn only while the object stands on it."""
    grasp = Grasp(np.zeros(3), FROM_ABOVE)
    evaluation = held(model, grasp)
    evaluation.fields["post_pickup"].von_mises_stress[:] = 123.0
    scene = Scene.of_evaluation(model, load_gripper(), grasp, evaluation)
    np.testing.assert_allclose(scene.nodal_stress, 123.0)
    assert scene.platform is None
    evaluation.fields = {"at_target_force": evaluation.fields["post_pickup"]}
    scene = Scene.of_evaluation(model, load_gripper(), grasp, evaluation)
    assert scene.platform[:, 2].max() == pytest.approx(-EXTENTS[2] / 2.0)


def test_picture_of_one_grasp(model, tmp_path):
    """A held grasp is drawn in the colours of stress, a missed one without."""
    grasp = Grasp(np.zeros(3), FROM_ABOVE, id="top_$1")
    draw_evaluation(tmp_path / "held.png", model, load_gripper(), grasp, held(model, grasp))
    draw_evaluation(tmp_path / "missed.png", model, load_gripper(), grasp, missed(grasp))
    colourful, grey = (imread(tmp_path / f"{name}.png") for name in ("held", "missed"))
    assert colourful.shape == grey.shape and min(grey.shape[:2]) > 800
    assert saturated_fraction(colourful) > 0.05 > 2.0 * saturated_fraction(grey)
    assert grey[..., :3].min() < 0.9


def test_contact_sheet(model, tmp_path):
    """Every grasp has its panel: the picture grows with their number."""
    grasps = [Grasp(np.zeros(3), FROM_ABOVE, id=f"grasp {i}") for i in range(4)]
    evaluations = [held(model, grasps[0]), *(missed(grasp) for grasp in grasps[1:])]
    for count in (1, 4):
        draw_evaluations(tmp_path / f"{count}.png", model, load_gripper(), grasps[:count], evaluations[:count])
    one, four = (imread(tmp_path / f"{count}.png") for count in (1, 4))
    assert four.shape[0] > 1.5 * one.shape[0] and four.shape[1] > one.shape[1]


def test_contact_sheet_needs_one_evaluation_per_grasp(model, tmp_path):
    """Grasps and evaluations that do not belong together are not drawn."""
    with pytest.raises(ValueError):
        draw_evaluations(tmp_path / "none.png", model, load_gripper(), [Grasp(np.zeros(3), FROM_ABOVE)], [])
