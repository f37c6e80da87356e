"""The whole protocol: the object settles, every grasp is tried in the experiments that were asked for.

Grasp poses are relative to the object: they follow the small rigid motion with which it settles on the platform.
"""

from __future__ import annotations

from collections.abc import Sequence

from defgrasp_ros.errors import EmptyGraspListError
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
    time_limit: float | None = None,
) -> list[GraspEvaluation]:
    """Run the experiments of ``options.experiments`` for every grasp.

    Args:
        object_model: Object at rest in its frame, z up; it is put on a platform at its lowest point.
        grasps: Candidate poses in the object frame.
        gripper: Pads, stroke and limits.
        options: What to do, and the constants of the protocol.
        device: Warp device, ``"cpu"`` or ``"cuda:0"``.
        observer: Is told about progress, samples and results while the simulation runs.
        time_limit: Wall time after which the run ends [s]; grasps that are not finished come back with the code
            TIMEOUT. None: no limit. It is looked at before every time step of all grasps.

    Returns:
        One evaluation per grasp, in their order. What went wrong with a grasp is in its code and message.

    Raises:
        EmptyGraspListError: If there is no grasp.
        InvalidOptionsError: If the time limit is no positive number.
        NotFoundError: If there is no such device.
        ResourceExhaustedError: If it has not enough free memory for a single world.
        InvalidMeshError: If the mesh has no usable stiffness.
        SolverDivergedError: If the object alone finds no rest on the platform.
        CanceledError: If the observer wants the run to end before the object has come to rest.
    """
    if not grasps:
        raise EmptyGraspListError("grasps is empty: give at least one grasp")
    observer = observer or EvaluationObserver()
    interruption = Interruption(observer, time_limit)
    kind = "cuda" if find_device(device).is_cuda else "cpu"
    room = worlds_that_fit(object_model, find_device(device))
    batches = chunks(range(len(grasps)), min(MAX_BATCH[kind], room))
    world_count = len(batches[0])
    if options.experiments - {Experiment.PICKUP, Experiment.SQUEEZE}:
        world_count = min(MAX_WORLDS[kind], DIRECTION_COUNT * world_count, room)
    simulator = Simulator(object_model, gripper, world_count, device)
    observer.on_progress(Progress(Phase.SETTLE, 0.0, 0.0, len(grasps), len(grasps)))
    settled = settle(simulator, 0, options.time_step, observer.should_stop)
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
                candidate.end(why.code, f"{candidate.evaluation.message}; {why.message} before all was done")
            batch.report(candidate)
    return [candidate.evaluation for candidate in batch.candidates]
