"""The experiments after the pickup: a block with pads over its whole faces against rigid-body mechanics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import InvalidOptionsError, ResultCode
from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, Experiment, GraspEvaluation, Phase
from defgrasp_ros.experiments import acceleration, evaluate_grasps
from defgrasp_ros.experiments.directions import sphere_directions
from defgrasp_ros.experiments.slip_force import rotational_slip_force
from defgrasp_ros.experiments.state_sampler import StateSampler
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator

SIDE = 0.03
WIDE_PADS = replace(
    load_gripper(),
    pad_half_width=0.02,
    pad_bottom=-0.02,
    pad_top=0.02,
    tip=0.02,
    side_fillet=0.0,
    tip_fillet=0.0,
    palm=None,
)
FROM_ABOVE = Rotation.from_euler("x", np.pi).as_quat()
CLOSING = np.array([0.0, 1.0, 0.0])
DIRECTIONS = sphere_directions()
ALONG = np.flatnonzero(np.abs(DIRECTIONS @ CLOSING) > 0.999)
ACROSS = np.flatnonzero(np.abs(DIRECTIONS @ CLOSING) < 1e-9)


def block(
    youngs_modulus: float = 2e6, poissons_ratio: float = 0.0, friction: float = 0.7, cells: int = 2
) -> ObjectModel:
    material = Material(youngs_modulus, poissons_ratio, friction_coefficient=friction)
    return ObjectModel("block", box((SIDE, SIDE, SIDE), (cells, cells, cells)), material)


def evaluate(model: ObjectModel, force: float | None = None, pads=WIDE_PADS, **options) -> GraspEvaluation:
    grasp = Grasp(np.zeros(3), FROM_ABOVE, "block", force)
    (evaluation,) = evaluate_grasps(model, [grasp], pads, EvaluationOptions(pickup_hold_time=0.1, **options))
    assert evaluation.code == ResultCode.OK and evaluation.solver.converged
    return evaluation


def slip_and_loss(model: ObjectModel, force: float) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations of slip and of loss of contact in the linear test [m/s^2], shape ``(16,)`` each."""
    result = evaluate(model, force, experiments={"linear_acceleration"}, linear_jerk=400.0).linear_acceleration
    assert not any(result.reasons)
    return result.at_slip, result.at_loss


def test_sixteen_directions():
    """Unit vectors, each with its opposite, on rings of 4, 8 and 4 at 30, 90 and 150 degrees from the vertical."""
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1.0)
    polar = np.degrees(np.arccos(DIRECTIONS[:, 2]))
    np.testing.assert_allclose(polar, [30.0] * 4 + [90.0] * 8 + [150.0] * 4)
    distance = np.linalg.norm(DIRECTIONS[:, None] + DIRECTIONS[None], axis=2)
    assert (np.sort(distance, axis=1)[:, 0] < 1e-9).all()
    np.testing.assert_allclose(DIRECTIONS[0], [0.0, -0.5, np.sqrt(0.75)], atol=1e-12)


def test_slip_force_of_two_points():
    """Contacts at +-d, the centre of mass at distance R beyond: the two equivalent points are at +-d / 2."""
    contacts = np.array([[0.01, 0.02, 0.0], [-0.01, 0.02, 0.0], [0.01, -0.02, 0.0], [-0.01, -0.02, 0.0]])
    force = rotational_slip_force(contacts, np.array([0.035, 0.5, 0.0]), CLOSING, 2.0, 0.5, 1.3)
    assert force == pytest.approx(1.3 * 2.0 * (1.0 + 2.0 * 0.03 / 0.01) / 0.5)
    assert rotational_slip_force(contacts, np.array([0.0, 0.3, 0.0]), CLOSING, 2.0, 0.5, 1.3) == 0.0
    assert rotational_slip_force(contacts[:1], np.array([0.3, 0.0, 0.0]), CLOSING, 2.0, 0.5, 1.3) == np.inf


def test_turning_frame_is_only_a_point_of_view():
    """A body at rest, seen from a frame that turns ever faster, goes round in it, first order in the step."""
    model, here, centre = block(2e5), np.array([0]), np.array([[0.1, 0.0, 0.0]])
    axis, alpha, duration = np.array([0.0, 0.0, 1.0]), 20.0, 0.2
    angle = 0.5 * alpha * duration**2
    expected = Rotation.from_rotvec(-angle * axis).apply(model.mesh.vertices - centre) + centre
    errors = []
    for steps in (50, 100):
        simulator, h = Simulator(model, WIDE_PADS, 1), duration / steps
        simulator.set_gravity(here, np.zeros(3))
        for step in range(1, steps + 1):
            simulator.set_spin(here, centre, np.array([alpha * step * h * axis]), np.array([alpha * axis]))
            assert simulator.step(here, h, np.zeros(1), np.zeros(1), quasi_static=False).converged.all()
        errors.append(np.abs(simulator.positions(here)[0] - expected).max())
    assert errors[1] < 0.03 * 0.1
    assert 0.4 < errors[1] / errors[0] < 0.6


def test_contact_is_lost_where_inertia_has_used_up_the_squeeze():
    """Along the closing axis one pad is unloaded at a = 2 N / m, N the force of each; mirrored directions agree.

    It holds for nu = 0 and pads over the whole face, where the load stays even.
    """
    model, force = block(cells=4), 0.6
    _, at_loss = slip_and_loss(model, force)
    np.testing.assert_allclose(at_loss[ALONG], force / model.mass, rtol=0.02)
    assert at_loss[ALONG[0]] == pytest.approx(at_loss[ALONG[1]], rel=1e-3)


def test_slip_across_the_pads_follows_coulomb():
    """Across the closing axis the block slides at a = mu F / m; doubling friction or force doubles it."""
    slides = {}
    for friction, force in ((0.35, 1.2), (0.7, 1.2), (0.35, 2.4)):
        model = block(friction=friction)
        at_slip, _ = slip_and_loss(model, force)
        slides[friction, force] = at_slip[ACROSS]
        np.testing.assert_allclose(at_slip[ACROSS], friction * force / model.mass, rtol=0.05)
    np.testing.assert_allclose(slides[0.7, 1.2], 2.0 * slides[0.35, 1.2], rtol=0.05)
    np.testing.assert_allclose(slides[0.35, 2.4], 2.0 * slides[0.35, 1.2], rtol=0.05)


@pytest.mark.parametrize("cells", [4, 5])
def test_turning_slip_about_the_closing_axis_follows_the_torsional_friction(monkeypatch, cells):
    """Two square patches of side a under even pressure hold the torque mu F a (sqrt(2) + asinh(1)) / 6.

    With four cells there is a node at the centre of the turn, which never slides.
    The jerk is high, so that at slip the block hardly turns yet and centrifugal forces are small. The axis goes through
    the middle of the block, which the tips of pads over the whole face cannot reach.
    """
    monkeypatch.setattr(acceleration, "fingertip_midpoint", lambda candidate, tip: candidate.grasp.position)
    model, force = block(2e9, cells=cells), 0.6
    options = {"angular_jerk": 1e5, "acceleration_time_step": 1e-4, "max_angular_acceleration": 1500.0}
    result = evaluate(model, force, experiments={"angular_acceleration"}, **options).angular_acceleration
    torque = model.material.friction_coefficient * force * SIDE * (np.sqrt(2.0) + np.arcsinh(1.0)) / 6.0
    lumped = model.mesh.node_volumes @ (model.mesh.vertices[:, [0, 2]] ** 2).sum(axis=1)
    inertia = model.material.density * lumped
    np.testing.assert_allclose(result.at_slip[ALONG], torque / inertia, rtol=0.05)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("mirror", [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
def test_accelerations_of_a_symmetric_grasp_are_symmetric(symmetric_accelerations, mirror):
    """Along mirrored directions slip and loss come at the same acceleration; about mirrored axes as well."""
    for result, sign in zip(symmetric_accelerations, (1.0, -1.0), strict=True):
        # An axis is mirrored like a magnetic field: the part across the mirror stays, the others turn round.
        images = [int(np.linalg.norm(DIRECTIONS - sign * d * mirror, axis=1).argmin()) for d in DIRECTIONS]
        assert sorted(images) == list(range(16)) and not any(result.reasons)
        np.testing.assert_allclose(result.at_loss, result.at_loss[images], rtol=0.02)
        np.testing.assert_allclose(result.at_slip, result.at_slip[images], rtol=0.02)
        assert np.isfinite(result.at_slip).sum() >= 8


@pytest.fixture(scope="module")
def symmetric_accelerations():
    """Both tests of a block in the middle of the hand; a mesh of an even number of cells is symmetric."""
    limits = {"max_linear_acceleration": 100.0, "angular_jerk": 4e4, "max_angular_acceleration": 2000.0}
    both = {"linear_acceleration", "angular_acceleration"}
    evaluation = evaluate(block(2e5, 0.3), 0.6, load_gripper(), experiments=both, **limits)
    return evaluation.linear_acceleration, evaluation.angular_acceleration


def test_reorientation_of_a_symmetric_grasp_is_symmetric():
    """All 64 states are reached; half turns about opposite axes end alike, and so do mirrored axes."""
    evaluation = evaluate(block(2e5, 0.3), pads=load_gripper(), experiments={Experiment.REORIENTATION})
    result = evaluation.reorientation
    assert not any(result.reasons) and np.isfinite(result.max_deformation).all()
    assert evaluation.metrics.deformation_controllability == result.max_deformation.max()
    opposite = [int(np.linalg.norm(DIRECTIONS + d, axis=1).argmin()) for d in DIRECTIONS]
    np.testing.assert_allclose(result.max_deformation[:, 3], result.max_deformation[opposite, 3], rtol=0.02)
    mirrored = [int(np.linalg.norm(DIRECTIONS * [-1.0, 1.0, 1.0] + d, axis=1).argmin()) for d in DIRECTIONS]
    np.testing.assert_allclose(result.max_deformation, result.max_deformation[mirrored], rtol=0.02)
    assert result.closing_force >= evaluation.target_force


def test_reorientation_recorded_in_motion():
    """Snapshots in motion feel the centrifugal force as well, but little of it at 3 rad/s in a block of 30 mm."""
    model, pads = block(2e5, 0.3), load_gripper()
    at_rest, in_motion = (
        evaluate(model, pads=pads, experiments={"reorientation"}, reorientation_settles=settles).reorientation
        for settles in (True, False)
    )
    assert not any(in_motion.reasons)
    np.testing.assert_allclose(in_motion.max_deformation, at_rest.max_deformation, rtol=0.1)
    assert np.abs(in_motion.max_deformation - at_rest.max_deformation).max() > 1e-9


def test_squeeze_is_linear_where_the_block_is():
    """Without gravity, nu = 0 and whole faces: shortening F L / 2 E A and energy grow with the force and its square."""
    model = block(2e5)
    options = {"squeeze_force": 0.5, "squeeze_sample_count": 4}
    result = evaluate(model, 0.6, experiments={"squeeze"}, **options).squeeze
    assert not result.reason
    np.testing.assert_allclose(result.force, [0.125, 0.25, 0.375, 0.5])
    stress = 0.5 * result.force / SIDE**2
    np.testing.assert_allclose(2.0 * result.opening, SIDE * (1.0 - stress / 2e5), rtol=1e-5)
    np.testing.assert_allclose(result.strain_energy, 0.5 * stress**2 / 2e5 * SIDE**3, rtol=1e-3)
    assert all(left.count and right.count for left, right in result.contacts)


def test_a_dropped_object_has_no_figures():
    """What was not picked up is neither turned nor accelerated: its metrics are not numbers, never zero."""
    grasp = Grasp(np.zeros(3), FROM_ABOVE, "weak", 0.5 * block().weight)
    options = EvaluationOptions(pickup_hold_time=0.1, experiments={"linear_acceleration", "reorientation"})
    (evaluation,) = evaluate_grasps(block(), [grasp], WIDE_PADS, options)
    assert evaluation.code == ResultCode.DROPPED and evaluation.message
    assert evaluation.linear_acceleration is None and evaluation.reorientation is None
    assert np.isnan(evaluation.metrics.linear_instability)
    assert np.isnan(evaluation.metrics.deformation_controllability)


class Witness(EvaluationObserver):
    """Keeps the results, and stops the run in a phase."""

    def __init__(self, stop_in: Phase | None = None):
        self.stop_in, self.stopped, self.evaluations = stop_in, False, []

    def on_progress(self, progress):
        self.stopped |= progress.phase == self.stop_in

    def on_evaluation(self, evaluation):
        self.evaluations.append((evaluation.code, evaluation.squeeze is not None))

    def should_stop(self):
        return self.stopped


def test_results_are_told_when_all_is_known():
    """A dropped object that is squeezed afterwards is reported once, with the squeeze."""
    witness, grasp = Witness(), Grasp(np.zeros(3), FROM_ABOVE, "weak", 0.5 * block().weight)
    squeeze = {"experiments": {"squeeze"}, "squeeze_force": 0.2, "squeeze_sample_count": 2}
    options = EvaluationOptions(pickup_hold_time=0.1, **squeeze)
    evaluate_grasps(block(), [grasp], WIDE_PADS, options, observer=witness)
    assert witness.evaluations == [(ResultCode.DROPPED, True)]


def test_stopping_after_the_pickup():
    """What was measured stays, the code says that the rest is missing."""
    witness, grasp = Witness(Phase.ACCELERATE), Grasp(np.zeros(3), FROM_ABOVE, "block", 0.6)
    options = EvaluationOptions(pickup_hold_time=0.1, experiments={"linear_acceleration"})
    (evaluation,) = evaluate_grasps(block(), [grasp], WIDE_PADS, options, observer=witness)
    assert evaluation.code == ResultCode.CANCELED and evaluation.metrics.pickup_success
    assert np.isnan(evaluation.metrics.linear_instability)
    assert set(evaluation.linear_acceleration.reasons) == {"canceled"}


def test_unknown_experiment():
    """A name that does not exist is refused with those that do."""
    with pytest.raises(InvalidOptionsError, match=r"'shake'.*linear_acceleration"):
        EvaluationOptions(experiments={"shake"})


def test_state_of_a_pickup_is_read_once(monkeypatch):
    """At an instant that both the course and the observer want, the simulator is asked a single time."""
    read, seen = [], []

    def counted(self, time, *arguments):
        read.append(time)
        return original(self, time, *arguments)

    class Watcher(EvaluationObserver):
        def on_samples(self, samples):
            seen.append(samples[0].time)

    original = StateSampler.read
    monkeypatch.setattr(StateSampler, "read", counted)
    grasp = Grasp(np.zeros(3), FROM_ABOVE, "block")
    options = EvaluationOptions(pickup_hold_time=0.1)
    (evaluation,) = evaluate_grasps(block(), [grasp], WIDE_PADS, options, observer=Watcher())
    assert len(read) == len(set(read)) == len(evaluation.pickup.time) > 10
    assert set(seen) <= set(read) and len(seen) > 10


class FieldFollower(EvaluationObserver):
    """Wants the fields, and keeps what it is told."""

    def __init__(self):
        self.evaluations = []

    def wants_fields(self):
        return True

    def on_evaluation(self, evaluation):
        self.evaluations.append(evaluation)


def test_observer_gets_fields_that_are_not_returned():
    """What an observer wants changes no number, and fields are not kept beyond what it is told."""
    options = EvaluationOptions(
        pickup_hold_time=0.1, experiments="reorientation,squeeze", reorientation_speed=30.0, squeeze_sample_count=2
    )
    grasp, follower = Grasp(np.zeros(3), FROM_ABOVE, "block"), FieldFollower()
    (returned,) = evaluate_grasps(block(), [grasp], WIDE_PADS, options, observer=follower)
    (told,) = follower.evaluations
    assert set(told.fields) == {"pre_contact", "at_target_force", "post_pickup"}
    assert len(told.reorientation.states) == 64 and len(told.squeeze.states) == 2
    assert not returned.fields and not returned.reorientation.states and not returned.squeeze.states
    largest = max(state.von_mises_stress.max() for state in told.reorientation.states.values())
    assert largest == pytest.approx(returned.reorientation.max_von_mises_stress.max(), rel=1e-6)
    (plain,) = evaluate_grasps(block(), [grasp], WIDE_PADS, options)
    assert not plain.fields
    np.testing.assert_array_equal(plain.reorientation.max_deformation, told.reorientation.max_deformation)
    np.testing.assert_array_equal(plain.squeeze.strain_energy, told.squeeze.strain_energy)
    assert plain.metrics == returned.metrics
