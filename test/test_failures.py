"""Every way in which a grasp or an experiment fails has its code, numbers that are missing, and a reason."""

import dataclasses
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from defgrasp_ros import stop_signal
from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, Experiment, GraspEvaluation, Phase
from defgrasp_ros.experiments import evaluate_grasps
from defgrasp_ros.experiments.candidate import Candidate
from defgrasp_ros.experiments.interruption import Interruption
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator
from defgrasp_ros.stop_signal import StopSignal

FROM_ABOVE = Rotation.from_euler("x", np.pi).as_quat()
MODEL = ObjectModel("block", box((0.03, 0.03, 0.03), (2, 2, 2)), Material(2e5))
SHORT = EvaluationOptions(
    pickup_hold_time=0.05, max_linear_acceleration=5.0, max_angular_acceleration=50.0, squeeze_sample_count=2
)
RESULT_OF = {
    Phase.REORIENT: Experiment.REORIENTATION,
    Phase.ACCELERATE: Experiment.LINEAR_ACCELERATION,
    Phase.SQUEEZE_FREE: Experiment.SQUEEZE,
}
METRIC_OF = {
    Phase.REORIENT: "deformation_controllability",
    Phase.ACCELERATE: "linear_instability",
    Phase.SQUEEZE_FREE: None,
}


def evaluate(options: EvaluationOptions, observer: EvaluationObserver | None = None, **given) -> GraspEvaluation:
    grasp = Grasp(np.zeros(3), FROM_ABOVE, "block", **given)
    return evaluate_grasps(MODEL, [grasp], load_gripper(), options, observer=observer)[0]


def missing(record: object) -> bool:
    """Whether no number of features or metrics was measured."""
    values = dataclasses.asdict(record).values()
    return all(math.isnan(value) for value in values if not isinstance(value, bool))


def reason_of(evaluation: GraspEvaluation, experiment: Experiment) -> str:
    """The one reason of an experiment."""
    result = getattr(evaluation, experiment)
    if experiment is Experiment.SQUEEZE:
        return result.reason
    (reason,) = set(result.reasons) - {""}
    return reason


class PhaseFollower(EvaluationObserver):
    """Knows the phase, and cancels the run in one of them."""

    def __init__(self, canceled_in: Phase | None = None):
        self.phase, self.canceled_in = Phase.PREPARE, canceled_in

    def on_progress(self, progress):
        self.phase = progress.phase

    def should_stop(self):
        return self.phase is self.canceled_in


# --- the squeeze that does not reach its force ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pads", "opening", "was_gripped", "code", "text"),
    [
        ((0.0, 0.0), 0.0, False, ResultCode.NO_CONTACT, "the pads met without both having touched the object"),
        ((0.0, 0.0), -1e-6, True, ResultCode.FORCE_NOT_REACHED, "squeezed out"),
        ((0.6, 0.3), 0.01, True, ResultCode.FORCE_NOT_REACHED, r"reached 0\.9 N of the 2 N asked for"),
        ((0.5, 0.0), 0.01, False, ResultCode.NO_CONTACT, r"only the left finger touches.*platform force 0\.3 N"),
        ((0.0, 0.5), 0.01, True, ResultCode.NO_CONTACT, "only the right finger touches"),
        ((0.0, 0.0), 0.01, False, ResultCode.NO_CONTACT, "no finger touches"),
    ],
)
def test_why_a_squeeze_failed(pads, opening, was_gripped, code, text):
    """From forces and opening at the end follows the code, with a text that says what happened."""
    candidate = Candidate(Grasp(np.zeros(3), FROM_ABOVE), 2.0, GraspEvaluation(0, "0"), 0.0, was_gripped=was_gripped)
    found, message = candidate.squeeze_failure(np.array(pads), 0.3, opening)
    assert found is code
    assert re.search(text, message)


def test_one_finger_that_cannot_push_the_object_to_the_other():
    """Off centre and with less force than friction on the platform resists, one pad stays without contact."""
    options, weight = replace(SHORT, squeeze_time=0.05), MODEL.weight
    grasp = Grasp(np.array([0.0, 0.003, 0.0]), FROM_ABOVE, "weak", 0.3 * weight)
    (evaluation,) = evaluate_grasps(MODEL, [grasp], load_gripper(), options)
    assert evaluation.code is ResultCode.NO_CONTACT and "only the" in evaluation.message
    assert missing(evaluation.features) and missing(evaluation.metrics)
    assert evaluation.contacts is None and math.isnan(evaluation.applied_force)
    assert evaluation.pickup is not None and set(evaluation.pickup.phase) == {Phase.SQUEEZE}


# --- a run that ends early --------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", RESULT_OF)
def test_canceled_in_a_later_experiment(phase):
    """The pickup's numbers stay; the experiment has none and says that it was canceled."""
    evaluation = evaluate(replace(SHORT, experiments={RESULT_OF[phase]}), PhaseFollower(phase))
    assert evaluation.code is ResultCode.CANCELED
    assert evaluation.message == "picked up and held; ended before all was done: canceled"
    assert evaluation.metrics.pickup_success and evaluation.metrics.strain_energy > 0.0
    assert reason_of(evaluation, RESULT_OF[phase]).endswith("canceled")
    if METRIC_OF[phase]:
        assert math.isnan(getattr(evaluation.metrics, METRIC_OF[phase]))


@pytest.mark.parametrize("phase", [Phase.SQUEEZE, Phase.LOWER_PLATFORM])
def test_canceled_in_the_pickup(phase):
    """There are no metrics; features are there if the target force was reached."""
    evaluation = evaluate(replace(SHORT, experiments="all"), PhaseFollower(phase))
    assert evaluation.code is ResultCode.CANCELED
    assert evaluation.message == "ended before this grasp was finished: canceled"
    assert missing(evaluation.metrics)
    assert missing(evaluation.features) == (phase is Phase.SQUEEZE)
    assert evaluation.reorientation is evaluation.linear_acceleration is evaluation.angular_acceleration is None


def test_time_limit_in_a_later_experiment(monkeypatch):
    """What a time limit leaves out is marked as such, and what was measured before stays."""
    now, stop = [0.0], StopSignal()
    monkeypatch.setattr(stop_signal.time, "monotonic", lambda: now[0])
    stop.limit(5.0)

    class Clock(EvaluationObserver):
        def on_progress(self, progress):
            now[0] = 10.0 if progress.phase is Phase.ACCELERATE else 0.0

    grasp = Grasp(np.zeros(3), FROM_ABOVE, "block")
    options = replace(SHORT, experiments={"linear_acceleration"})
    (evaluation,) = evaluate_grasps(MODEL, [grasp], load_gripper(), options, observer=Clock(), stop=stop)
    assert evaluation.code is ResultCode.TIMEOUT and evaluation.metrics.pickup_success
    assert evaluation.message.endswith("ended before all was done: stopped at the time limit of 5 s")
    assert set(evaluation.linear_acceleration.reasons) == {"stopped at the time limit of 5 s"}
    assert math.isnan(evaluation.metrics.linear_instability)


@pytest.mark.parametrize("phase", RESULT_OF)
def test_a_stop_from_outside_is_the_reason_of_every_direction(phase):
    """Whoever ends the run says why, and each direction and the grasp repeat it."""
    stop = StopSignal()

    class Ending(EvaluationObserver):
        def on_progress(self, progress):
            if progress.phase is phase:
                stop.set(ResultCode.TIMEOUT, "the shift is over")

    grasp, options = Grasp(np.zeros(3), FROM_ABOVE, "block"), replace(SHORT, experiments={RESULT_OF[phase]})
    (evaluation,) = evaluate_grasps(MODEL, [grasp], load_gripper(), options, observer=Ending(), stop=stop)
    assert evaluation.code is ResultCode.TIMEOUT
    assert evaluation.message == "picked up and held; ended before all was done: the shift is over"
    assert reason_of(evaluation, RESULT_OF[phase]).endswith("the shift is over")


def test_the_first_reason_to_stop_stays(monkeypatch):
    """A run that reached its time limit is not canceled afterwards."""
    observer, stop = PhaseFollower(Phase.DONE), StopSignal()
    monkeypatch.setattr(stop_signal.time, "monotonic", lambda: 0.0)
    stop.limit(1.0)
    watch = Interruption(observer, stop)
    assert watch.reason() is None
    monkeypatch.setattr(stop_signal.time, "monotonic", lambda: 2.0)
    assert watch.reason().code is ResultCode.TIMEOUT
    observer.phase = Phase.DONE
    assert watch.reason().code is ResultCode.TIMEOUT


# --- steps without a solution -----------------------------------------------------------------------------------


def follower_that_alters_steps(monkeypatch, phase: Phase, alter) -> PhaseFollower:
    """Return an observer in whose given phase the report of every step is altered."""
    follower, step = PhaseFollower(), Simulator.step

    def altered_step(self, *arguments, **options):
        report = step(self, *arguments, **options)
        if follower.phase is phase:
            alter(report)
        return report

    monkeypatch.setattr(Simulator, "step", altered_step)
    return follower


@pytest.fixture
def diverging(monkeypatch):
    """Returns an observer in whose given phase no step has a solution."""

    def alter(report):
        report.converged[:] = False
        report.residual[:] = 0.5

    return lambda phase: follower_that_alters_steps(monkeypatch, phase, alter)


@pytest.mark.parametrize("phase", [Phase.SQUEEZE, Phase.LOWER_PLATFORM])
def test_no_solution_in_the_pickup(diverging, phase):
    """The grasp ends with its own code, and nothing is measured from there on."""
    evaluation = evaluate(replace(SHORT, experiments={"linear_acceleration"}), diverging(phase))
    assert evaluation.code is ResultCode.SOLVER_DIVERGED
    assert "residual 0.5 of the force scale" in evaluation.message
    assert not evaluation.solver.converged and evaluation.solver.residual == 0.5
    assert missing(evaluation.metrics) and evaluation.linear_acceleration is None
    assert missing(evaluation.features) == (phase is Phase.SQUEEZE)


@pytest.mark.parametrize("phase", RESULT_OF)
def test_no_solution_in_a_later_experiment(diverging, phase):
    """The pickup stays a success; the experiment has a reason in place of its metric."""
    evaluation = evaluate(replace(SHORT, experiments={RESULT_OF[phase]}), diverging(phase))
    assert evaluation.code is ResultCode.OK and evaluation.metrics.pickup_success
    assert not evaluation.solver.converged
    assert "no solution of the time step" in reason_of(evaluation, RESULT_OF[phase])
    if METRIC_OF[phase]:
        assert math.isnan(getattr(evaluation.metrics, METRIC_OF[phase]))


# --- an object that is crushed or torn ---------------------------------------------------------------------------


@pytest.fixture
def crushing(monkeypatch):
    """Returns an observer in whose given phase every step turns elements inside out."""
    return lambda phase: follower_that_alters_steps(monkeypatch, phase, lambda report: report.crushed.fill(True))


@pytest.mark.parametrize("phase", [Phase.SQUEEZE, Phase.LOWER_PLATFORM])
def test_crushed_in_the_pickup(crushing, phase):
    """The grasp ends with a message that tells it from a solver that fails."""
    evaluation = evaluate(SHORT, crushing(phase))
    assert evaluation.code is ResultCode.SOLVER_DIVERGED and evaluation.solver.converged
    assert "the load crushes or tears the object" in evaluation.message
    assert missing(evaluation.metrics)


def test_torn_by_an_acceleration(crushing):
    """Contact was kept as long as there was an object: a lower bound, as at the end of the test."""
    evaluation = evaluate(replace(SHORT, experiments={"linear_acceleration"}), crushing(Phase.ACCELERATE))
    result = evaluation.linear_acceleration
    assert evaluation.code is ResultCode.OK and not any(result.reasons)
    assert result.is_lower_bound.all() and (result.at_loss < SHORT.max_linear_acceleration).all()


# --- an object that is lost after the pickup ---------------------------------------------------------------------


def test_dropped_while_turned(monkeypatch):
    """A finger that loses the object ends the axis there: no numbers from that state on, and no controllability."""
    follower, normal_forces = PhaseFollower(), Simulator.normal_forces

    def without_left_finger(self, worlds):
        forces = normal_forces(self, worlds)
        if follower.phase is Phase.REORIENT:
            forces[:, 0] = 0.0
        return forces

    monkeypatch.setattr(Simulator, "normal_forces", without_left_finger)
    evaluation = evaluate(replace(SHORT, experiments={"reorientation"}), follower)
    result = evaluation.reorientation
    assert evaluation.code is ResultCode.OK
    assert set(result.reasons) == {"on the way to 45 degrees: the object slipped out of the hand"}
    assert np.isnan(result.max_deformation).all() and np.isnan(result.max_von_mises_stress).all()
    assert math.isnan(evaluation.metrics.deformation_controllability)
