"""The pickup experiment on a soft block: what is held, what is not, and why."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import EmptyGraspListError, InvalidOptionsError, ResultCode
from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, GraspEvaluation, Phase
from defgrasp_ros.experiments import evaluate, evaluate_grasps
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.stop_signal import StopSignal

FROM_ABOVE = Rotation.from_euler("x", np.pi).as_quat()
OPTIONS = EvaluationOptions(pickup_hold_time=0.5, return_fields=True)


def block(youngs_modulus: float = 1e5, extents=(0.03, 0.03, 0.03)) -> ObjectModel:
    return ObjectModel("block", box(extents, (3, 3, 3)), Material(youngs_modulus=youngs_modulus))


def grasp(id: str, position=(0.0, 0.0, 0.0), orientation=FROM_ABOVE, target_force: float | None = None) -> Grasp:
    return Grasp(np.array(position), np.array(orientation), id, target_force)


class Witness(EvaluationObserver):
    """Keeps everything it is shown."""

    sample_interval = 0.05

    def __init__(self):
        self.progress, self.samples, self.evaluations = [], [], []

    def on_progress(self, progress):
        self.progress.append(progress)

    def on_samples(self, samples):
        self.samples += samples

    def on_evaluation(self, evaluation):
        self.evaluations.append(evaluation)


@pytest.fixture(scope="module")
def run() -> tuple[ObjectModel, list[GraspEvaluation], Witness]:
    model, witness = block(), Witness()
    weak = 0.8 * model.weight / model.material.friction_coefficient
    grasps = [
        grasp("held"),
        grasp("too weak", target_force=weak),
        grasp("beside", position=(0.06, 0.0, 0.0)),
        grasp("inside", position=(0.0, 0.05, 0.0)),
        grasp("too strong", target_force=1e3),
        grasp("off centre", position=(0.0, 0.002, 0.0)),
    ]
    return model, evaluate_grasps(model, grasps, load_gripper(), OPTIONS, observer=witness), witness


def test_each_grasp_ends_with_its_own_code(run):
    """Success, slipping out, closing on nothing, collision and a force beyond the gripper are told apart."""
    _, evaluations, _ = run
    assert {e.grasp_id: e.code for e in evaluations} == {
        "held": ResultCode.OK,
        "too weak": ResultCode.DROPPED,
        "beside": ResultCode.NO_CONTACT,
        "inside": ResultCode.GRIPPER_COLLISION,
        "too strong": ResultCode.FORCE_NOT_REACHED,
        "off centre": ResultCode.OK,
    }
    assert [e.grasp_index for e in evaluations] == list(range(6))
    assert all(e.message for e in evaluations)
    assert all(e.solver.converged for e in evaluations)


def test_pickup_with_elements_of_order_two():
    """Ten-node elements go through the whole experiment and carry the weight; every node and element has its field.

    Their energy is that of a much finer mesh of four-node elements, but for what a pad's sharp edges cost 7.5 mm nodes.
    """
    coarse = ObjectModel("coarse", replace(box((0.03, 0.03, 0.03), (2, 2, 2)), element_order=2), Material(1e5))
    fine = ObjectModel("fine", box((0.03, 0.03, 0.03), (8, 8, 8)), Material(1e5))
    energies = []
    for model in (coarse, fine):
        evaluation = evaluate_grasps(model, [grasp("held")], load_gripper(), OPTIONS)[0]
        assert evaluation.code == ResultCode.OK and evaluation.solver.converged
        carried = sum(finger.forces.sum(axis=0) for finger in evaluation.contacts)
        np.testing.assert_allclose(carried, [0.0, 0.0, model.weight], atol=1e-3 * model.weight)
        state = evaluation.fields["post_pickup"]
        assert state.positions.shape == model.mesh.vertices.shape
        assert state.von_mises_stress.shape == (len(model.mesh.tetrahedra),)
        energies.append(evaluation.metrics.strain_energy)
    assert energies[0] == pytest.approx(energies[1], rel=0.3)


def test_pads_carry_the_weight(run):
    """At the end of the hold, normal and friction forces of the pads sum to the weight, and nothing else."""
    model, evaluations, _ = run
    for evaluation in evaluations:
        if evaluation.code is ResultCode.OK:
            total = sum(finger.forces.sum(axis=0) for finger in evaluation.contacts)
            np.testing.assert_allclose(total, [0.0, 0.0, model.weight], atol=1e-3 * model.weight)


def test_target_force_is_the_sum_of_both_pads(run):
    """F_p = 1.3 m g / mu by default, and the measured force meets it to 0.1 %."""
    model, evaluations, _ = run
    held = evaluations[0]
    assert held.target_force == pytest.approx(1.3 * model.weight / 0.7)
    for evaluation in evaluations:
        if not math.isnan(evaluation.applied_force):
            assert evaluation.applied_force == pytest.approx(evaluation.target_force, rel=1e-3)


def test_what_was_not_measured_is_nan(run):
    """A dropped object keeps its features and has no metrics; a missed one has neither."""
    _, evaluations, _ = run
    dropped, missed = evaluations[1], evaluations[2]
    assert not dropped.metrics.pickup_success and math.isnan(dropped.metrics.max_von_mises_stress)
    assert dropped.features.contact_count > 0
    assert math.isnan(missed.features.contact_count) and missed.contacts is None
    assert math.isnan(missed.metrics.strain_energy) and math.isnan(missed.applied_force)


def test_metrics_agree_with_the_fields(run):
    """The largest stress is that of the stage post_pickup; the stages come in order with the pads closing."""
    _, evaluations, _ = run
    held = evaluations[0]
    fields = held.fields
    assert list(fields) == ["pre_contact", "at_target_force", "post_pickup"]
    assert held.metrics.max_von_mises_stress == fields["post_pickup"].von_mises_stress.max()
    assert held.features.gripper_separation == pytest.approx(2 * fields["at_target_force"].opening)
    assert 0.0 < held.features.squeeze_distance < 0.005
    assert held.metrics.max_deformation < 0.005


def test_an_offset_grasp_centres_the_object(run):
    """One finger pushes the block until the other touches: separation is that of the centred grasp."""
    _, evaluations, _ = run
    centred, offset = evaluations[0], evaluations[5]
    assert offset.features.gripper_separation == pytest.approx(centred.features.gripper_separation, rel=1e-2)
    shift = offset.fields["at_target_force"].positions - centred.fields["at_target_force"].positions
    assert shift[:, 1].mean() == pytest.approx(0.002, rel=0.02)


def test_the_observer_sees_the_run(run):
    """Progress rises to 1, samples show both fingers, every evaluation is announced once."""
    model, evaluations, witness = run
    fractions = [progress.fraction for progress in witness.progress]
    assert 0.0 <= min(fractions) and fractions[-1] == max(fractions) == 1.0
    assert len(set(fractions)) > 20
    assert sorted(e.grasp_index for e in witness.evaluations) == list(range(len(evaluations)))
    last = [sample for sample in witness.samples if sample.grasp_id == "held"][-1]
    assert last.phase is Phase.HOLD and last.platform_force == 0.0
    assert sum(finger.normal_force for finger in last.contacts) == pytest.approx(evaluations[0].target_force, rel=1e-2)
    settled = [s for s in witness.samples if s.grasp_id == "held" and s.phase is Phase.SQUEEZE][-1]
    pads = sum(finger.forces.sum(axis=0)[2] for finger in settled.contacts)
    assert settled.platform_force + pads == pytest.approx(model.weight, rel=1e-4)


def test_observing_changes_nothing():
    """An observer that wants no samples gets none, and the results are bit by bit those of one that reads all."""

    class Blind(Witness):
        def wants_samples(self):
            return False

    class Reader(Witness):
        def on_samples(self, samples):
            self.samples += [sample.read_fields() for sample in samples]

    blind, reader = Blind(), Reader()
    short = EvaluationOptions(pickup_hold_time=0.1, squeeze_time=0.05, platform_speed=1.0)
    for observer in (blind, reader):
        evaluate_grasps(block(), [grasp("held")], load_gripper(), short, observer=observer)
    assert not blind.samples and reader.samples
    (unseen,), (seen,) = blind.evaluations, reader.evaluations
    assert (unseen.metrics, unseen.features, unseen.solver) == (seen.metrics, seen.features, seen.solver)


def test_fields_of_the_last_sample_are_those_of_the_metrics():
    """Displacement and stress that are shown at the end of the hold lead to the evaluation's own numbers."""

    class Reader(EvaluationObserver):
        def on_samples(self, samples):
            self.fields = samples[0].read_fields()

    model, reader = block(), Reader()
    (evaluation,) = evaluate_grasps(model, [grasp("held")], load_gripper(), OPTIONS, observer=reader)
    assert reader.fields.displacement.max() == pytest.approx(evaluation.metrics.max_deformation, rel=1e-2)
    np.testing.assert_allclose(reader.fields.positions, evaluation.fields["post_pickup"].positions, atol=1e-5)
    nodal = model.mesh.nodal_mean(evaluation.fields["post_pickup"].von_mises_stress)
    np.testing.assert_allclose(reader.fields.von_mises_stress, nodal, rtol=2e-2)


def test_the_course_of_a_pickup(run):
    """Samples are even; both pads carry the target force in the hold, the platform the weight before, nothing then."""
    model, evaluations, _ = run
    course, target = evaluations[0].pickup, evaluations[0].target_force
    assert (np.diff(course.time) > 0.0).all()
    loading = course.time[course.phase == Phase.SQUEEZE]
    np.testing.assert_allclose(np.diff(loading), EvaluationObserver.sample_interval)
    assert list(dict.fromkeys(course.phase)) == [Phase.SQUEEZE, Phase.LOWER_PLATFORM, Phase.HOLD]
    assert (np.diff(course.opening[course.phase == Phase.SQUEEZE]) <= 0.0).all()
    held = course.phase == Phase.HOLD
    np.testing.assert_allclose((course.left_normal_force + course.right_normal_force)[held], target, rtol=1e-2)
    assert course.platform_force[0] == pytest.approx(model.weight, rel=0.1)
    assert (course.platform_force[held] == 0.0).all()
    assert np.isnan(course.slip[0]) and 0.0 <= course.slip[-1] < 1e-3
    assert course.max_von_mises_stress[-1] == pytest.approx(evaluations[0].metrics.max_von_mises_stress, rel=0.05)


def test_when_and_how_far_a_dropped_object_slips(run):
    """The time of the loss is there for what was lost alone; what was held has hardly slipped."""
    _, evaluations, _ = run
    held, dropped, missed = evaluations[:3]
    assert math.isnan(held.loss_of_contact_time) and 0.0 <= held.slip_distance < 1e-3
    lowering = dropped.pickup.time[dropped.pickup.phase == Phase.LOWER_PLATFORM][0]
    interval = Witness.sample_interval
    assert lowering + dropped.loss_of_contact_time == pytest.approx(dropped.pickup.time[-1], abs=2.0 * interval)
    assert dropped.pickup.slip[-1] > 1e-3
    assert missed.pickup is None and math.isnan(missed.slip_distance) and math.isnan(missed.loss_of_contact_time)


def test_palm_and_pads_carry_the_weight():
    """A block on the palm of a hand from below: pads and palm together balance the weight, pads do not."""
    model, pads = block(), load_gripper()
    upside_down = grasp("on the palm", position=(0.0, 0.0, -0.015 - pads.palm.face), orientation=(0.0, 0.0, 0.0, 1.0))
    (evaluation,) = evaluate_grasps(model, [upside_down], pads, OPTIONS)
    assert evaluation.code is ResultCode.OK
    carried = sum(finger.forces.sum(axis=0) for finger in evaluation.contacts)
    assert evaluation.palm_force[2] > 0.1 * model.weight
    np.testing.assert_allclose(carried + evaluation.palm_force, [0.0, 0.0, model.weight], atol=1e-3 * model.weight)


def test_closing_along_gravity():
    """A grasp with vertical closing axis: the lower pad carries the weight on top of the squeeze."""
    model = block(extents=(0.03, 0.03, 0.02))
    sideways = Rotation.from_matrix(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])).as_quat()
    (evaluation,) = evaluate_grasps(model, [grasp("vertical", orientation=sideways)], load_gripper(), OPTIONS)
    assert evaluation.code is ResultCode.OK
    assert evaluation.features.gravity_alignment == pytest.approx(0.0, abs=1e-3)
    upper, lower = sorted(evaluation.contacts, key=lambda finger: finger.centroid[2], reverse=True)
    assert lower.normal_force - upper.normal_force == pytest.approx(model.weight, rel=2e-3)


def test_the_platform_gives_way_to_a_vertical_grasp_off_centre():
    """Where the upper pad presses the object onto the platform, the lower one still gets its share."""
    model = block(2e6, extents=(0.03, 0.03, 0.02))
    sideways = Rotation.from_matrix(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])).as_quat()
    low = grasp("low", position=(0.0, 0.0, -0.003), orientation=sideways)
    (evaluation,) = evaluate_grasps(model, [low], load_gripper(), OPTIONS)
    assert evaluation.code is ResultCode.OK
    assert evaluation.applied_force == pytest.approx(evaluation.target_force, rel=1e-3)
    middle = np.mean([finger.centroid[2] for finger in evaluation.contacts])
    assert middle == pytest.approx(-0.003, abs=2e-4)


def test_a_grasp_does_not_depend_on_its_neighbours():
    """A turned grasp ends with the same numbers alone and beside one that slips out."""
    model = block(2e4)
    turned = grasp(
        "turned", orientation=(Rotation.from_euler("z", 25, degrees=True) * Rotation.from_quat(FROM_ABOVE)).as_quat()
    )
    weak = grasp("weak", target_force=0.9 * model.weight / model.material.friction_coefficient)
    (alone,) = evaluate_grasps(model, [turned], load_gripper(), OPTIONS)
    beside, _ = evaluate_grasps(model, [turned, weak], load_gripper(), OPTIONS)
    assert beside.code is alone.code is ResultCode.OK
    assert beside.metrics.max_von_mises_stress == pytest.approx(alone.metrics.max_von_mises_stress, rel=1e-4)
    assert beside.simulated_time == pytest.approx(alone.simulated_time)


def test_squeeze_distance_hardly_depends_on_the_time_step():
    """First contact is where the pads touch the settled shape: a quarter of the step changes next to nothing.

    What is left, up to 2 %, is how far friction lets the block lag behind while one finger pushes it to the other.
    """
    model = block(2e4)
    off_centre = grasp("off centre", position=(0.0, 0.002, 0.0))
    coarse, fine = (
        evaluate_grasps(model, [off_centre], load_gripper(), EvaluationOptions(pickup_hold_time=0.02, time_step=h))[0]
        for h in (1 / 200, 1 / 800)
    )
    assert coarse.features.squeeze_distance == pytest.approx(fine.features.squeeze_distance, rel=0.02)


def test_only_points_that_carry_force_count():
    """A stiff block off centre touches few points; those that hold only rounding are not counted."""
    model = block(2e9)
    (evaluation,) = evaluate_grasps(
        model,
        [grasp("off centre", position=(0.0, 0.0037, 0.0))],
        load_gripper(),
        EvaluationOptions(pickup_hold_time=0.1),
    )
    forces = np.concatenate([finger.normal_forces for finger in evaluation.contacts])
    assert forces.min() > 1e-6 * evaluation.target_force


def test_batches_give_what_one_batch_gives(monkeypatch):
    """More grasps than fit into a batch come out as they do together."""
    model, grasps = block(2e5), [grasp(str(i), position=(0.0, 0.0, 0.002 * i)) for i in range(3)]
    together = evaluate_grasps(model, grasps, load_gripper(), OPTIONS)
    monkeypatch.setitem(evaluate.MAX_BATCH, "cpu", 2)
    apart = evaluate_grasps(model, grasps, load_gripper(), OPTIONS)
    for one, other in zip(together, apart, strict=True):
        assert one.code is other.code and one.grasp_index == other.grasp_index
        assert other.metrics.max_von_mises_stress == pytest.approx(one.metrics.max_von_mises_stress, rel=1e-3)
        assert other.features.gripper_separation == pytest.approx(one.features.gripper_separation, rel=1e-6)


def test_stopping_keeps_what_is_finished():
    """A run that is told to stop marks what was not finished as canceled."""

    class Impatient(EvaluationObserver):
        def __init__(self):
            self.steps = 0

        def should_stop(self):
            self.steps += 1
            return self.steps > 10

    grasps = [grasp("held"), grasp("beside", position=(0.06, 0.0, 0.0))]
    evaluations = evaluate_grasps(block(), grasps, load_gripper(), OPTIONS, observer=Impatient())
    assert [e.code for e in evaluations] == [ResultCode.CANCELED, ResultCode.NO_CONTACT]


def test_time_limit_keeps_what_is_finished():
    """Once the time is over, what was not finished is marked as timed out; what failed before keeps its reason."""
    stop = StopSignal()

    class Squeezed(EvaluationObserver):
        def on_progress(self, progress):
            if progress.phase is Phase.SQUEEZE:
                stop.limit(1e-6)

    grasps = [grasp("held"), grasp("beside", position=(0.06, 0.0, 0.0))]
    evaluations = evaluate_grasps(block(), grasps, load_gripper(), OPTIONS, observer=Squeezed(), stop=stop)
    assert [e.code for e in evaluations] == [ResultCode.TIMEOUT, ResultCode.NO_CONTACT]
    assert evaluations[0].message == "ended before this grasp was finished: stopped at the time limit of 1e-06 s"
    assert np.isnan(evaluations[0].metrics.max_von_mises_stress)


def test_time_limit_counts_while_the_object_settles():
    """Every grasp is told to the observer and answered, although not one was begun."""
    stop, told = StopSignal(), []
    stop.limit(1e-6)

    class Listener(EvaluationObserver):
        def on_evaluation(self, evaluation):
            told.append(evaluation)

    grasps = [grasp("held"), grasp("")]
    evaluations = evaluate_grasps(block(), grasps, load_gripper(), OPTIONS, observer=Listener(), stop=stop)
    assert evaluations == told
    assert [(e.grasp_index, e.grasp_id, e.code) for e in told] == [
        (0, "held", ResultCode.TIMEOUT),
        (1, "1", ResultCode.TIMEOUT),
    ]
    text = "ended before the object had come to rest: stopped at the time limit of 1e-06 s"
    assert {e.message for e in told} == {text}


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan])
def test_time_limit_without_meaning_is_an_error(limit):
    """A time limit that is no positive number is refused by name."""
    with pytest.raises(InvalidOptionsError, match="time_limit"):
        StopSignal().limit(limit)


def test_no_grasp_is_an_error():
    """An empty list is refused with its own code."""
    with pytest.raises(EmptyGraspListError, match="at least one grasp"):
        evaluate_grasps(block(), [], load_gripper(), OPTIONS)
