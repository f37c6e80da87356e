"""The whole protocol: the object settles, every grasp is tried in the experiments that were asked for.

Grasp poses are relative to the object: they follow the small rigid motion with which it settles on the platform.
"""

from __future__ import annotations

from collections.abc import Sequence

from defgrasp_ros.errors import CanceledError, EmptyGraspListError, ResultCode
from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, Experiment, GraspEvaluation, Phase, Progress
from defgrasp_ros.experiments.acceleration import ANGULAR, LINEAR, AccelerationTest, frozen_without_gravity
from defgrasp_ros.experiments.batch import GraspBatch, Run, chunks
from defgrasp_ros.experiments.directions import DIRECTION_COUNT
from defgrasp_ros.experiments.discretisation_error import StressRecovery
from defgrasp_ros.experiments.interruption import Interruption
from defgrasp_ros.experiments.pickup import Pickup
from defgrasp_ros.experiments.reorientation import Reorientation
from defgrasp_ros.experiments.settling import settle
from defgrasp_ros.experiments.squeeze import FreeSqueeze
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.memory import worlds_that_fit
from defgrasp_ros.simulation.simulator import Simulator, find_device
from defgrasp_ros.stop_signal import StopSignal

MAX_BATCH = {"cpu": 64, "cuda": 1024}
"""Grasps simulated together at most, by kind of device; more run in further batches. On a processor a batch of 50 costs
no more per grasp than a larger one, and the first results come sooner."""
MAX_WORLDS = {"cpu": 256, "cuda": 4096}
"""Worlds simulated together in the experiments with 16 directions per grasp."""


def evaluate_grasps(
    object_model: ObjectModel,
    grasps: Sequence[Grasp],
    gripper: Gripper,
    options: EvaluationOptions,
    device: str = "cpu",
    observer: EvaluationObserver | None = None,
    stop: StopSignal | None = None,
) -> list[GraspEvaluation]:
    """Run the experiments of ``options.experiments`` for every grasp.

    Args:
        object_model: Object at rest in its frame, z up; it is put on a platform at its lowest point.
        grasps: Candidate poses in the object frame.
        gripper: Pads, stroke and limits.
        options: What to do, and the constants of the protocol.
        device: Warp device, ``"cpu"`` or ``"cuda:0"``.
        observer: Is told about progress, samples and results while the simulation runs.
        stop: Ends the run on demand or at its time limit, from any thread. It is looked at before every time step of
            all grasps, also while the object settles.

    Returns:
        One evaluation per grasp, in their order. What went wrong with a grasp is in its code and message; those that
        were not finished when the run was stopped have its code.

    Raises:
        EmptyGraspListError: If there is no grasp.
        NotFoundError: If there is no such device.
        ResourceExhaustedError: If it has not enough free memory for a single world.
        InvalidMeshError: If the mesh has no usable stiffness.
        SolverDivergedError: If the object alone finds no rest on the platform.
    """
    if not grasps:
        raise EmptyGraspListError("grasps is empty: give at least one grasp")
    observer = observer or EvaluationObserver()
    interruption = Interruption(observer, stop or StopSignal())
    kind = "cuda" if find_device(device).is_cuda else "cpu"
    room = worlds_that_fit(object_model, find_device(device))
    batches = chunks(range(len(grasps)), min(MAX_BATCH[kind], room))
    world_count = len(batches[0])
    if options.experiments - {Experiment.PICKUP, Experiment.SQUEEZE}:
        world_count = min(MAX_WORLDS[kind], DIRECTION_COUNT * world_count, room)
    simulator = Simulator(object_model, gripper, world_count, device)
    observer.on_progress(Progress(Phase.SETTLE, 0.0, 0.0, len(grasps), len(grasps)))
    try:
        settled = settle(simulator, 0, options.time_step, lambda: interruption.reason() is not None)
    except CanceledError as error:
        return _not_begun(grasps, f"{error}: {interruption.reason().message}", interruption.reason().code, observer)
    recovery = StressRecovery(object_model.mesh)
    run = Run(simulator, settled, options, observer, interruption, recovery, len(grasps))
    evaluations: list[GraspEvaluation] = []
    start = settled.duration
    for indices in batches:
        chosen = {index: grasps[index] for index in indices}
        batch = GraspBatch(run, chosen, start)
        evaluations += _run(batch)
        start = batch.time
    observer.on_progress(Progress(Phase.DONE, 1.0, start, 0, len(grasps)))
    return evaluations


def _not_begun(
    grasps: Sequence[Grasp], message: str, code: ResultCode, observer: EvaluationObserver
) -> list[GraspEvaluation]:
    """Report every grasp of a run that was stopped before its first."""
    evaluations = [GraspEvaluation(i, grasp.id or str(i), code, message) for i, grasp in enumerate(grasps)]
    for evaluation in evaluations:
        observer.on_evaluation(evaluation)
    return evaluations


def _run(batch: GraspBatch) -> list[GraspEvaluation]:
    """Do the experiments one after the other, each for all grasps that can."""
    Pickup(batch).run()
    if batch.asks_for(Experiment.REORIENTATION):
        batch.experiment = Experiment.REORIENTATION
        Reorientation(batch).run()
    if batch.asks_for(Experiment.LINEAR_ACCELERATION, Experiment.ANGULAR_ACCELERATION):
        kinds = [kind for kind in (LINEAR, ANGULAR) if batch.asks_for(kind.experiment)]
        batch.experiment = kinds[0].experiment
        frozen = frozen_without_gravity(batch)
        for kind in kinds:
            batch.experiment = kind.experiment
            AccelerationTest(batch, kind, frozen).run()
    if batch.asks_for(Experiment.SQUEEZE):
        batch.experiment = Experiment.SQUEEZE
        FreeSqueeze(batch).run()
    for candidate in batch.candidates:
        if not candidate.reported:
            why = batch.interrupted()
            if why and candidate.picked_up:
                candidate.end(why.code, f"{candidate.evaluation.message}; ended before all was done: {why.message}")
            batch.report(candidate)
    return [candidate.evaluation for candidate in batch.candidates]
