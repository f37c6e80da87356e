"""A log of a run that was never simulated: three grasps of a block, with made-up numbers that tests can predict."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from defgrasp_interfaces.msg import ContactState, EvaluationRequest, FingerContact, GraspEvaluation
from sensor_msgs.msg import JointState

from defgrasp_ros import evaluation as ev
from defgrasp_ros.errors import ResultCode
from defgrasp_ros.experiments.directions import sphere_directions
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.recording import RunLog, Topic, provenance, run_attachments
from defgrasp_ros.ros.object_source import RegisteredObject
from defgrasp_ros.ros.request_conversion import grasp_to_message, object_to_message, options_to_message
from defgrasp_ros.ros.result_conversion import evaluation_to_message

START = 1_700_000_000_000_000_000
BLOCK = box((0.03, 0.04, 0.03), (2, 3, 2))
MATERIAL = Material(youngs_modulus=1e5)
FROM_ABOVE = np.array([1.0, 0.0, 0.0, 0.0])
GRASPS = [
    Grasp(np.zeros(3), FROM_ABOVE, id="centre <b>", target_force=2.0),
    Grasp(np.array([0.0, 0.0, 0.005]), FROM_ABOVE, id="high"),
    Grasp(np.array([0.0, 0.2, 0.0]), FROM_ABOVE, id="beside"),
]
EXPERIMENTS = ("pickup", "reorientation", "linear_acceleration", "angular_acceleration", "squeeze")
CUT_OFF = 60
"""Bytes that a log lacks whose writer was killed: at least the footer."""
TOPICS = {
    "request": Topic("/evaluator/request", EvaluationRequest, depth=1, latched=True),
    "contacts": Topic("/evaluator/contacts", ContactState, depth=10),
    "joint_states": Topic("/evaluator/joint_states", JointState, depth=10),
    "evaluations": Topic("/evaluator/evaluations", GraspEvaluation, depth=50, latched=True),
}


def stretched(factor: float) -> ev.DeformedState:
    """The block, longer along x by a factor; stress 100 Pa in the first element, 1 Pa more in each further one."""
    stress = 100.0 + np.arange(len(BLOCK.tetrahedra), dtype=float)
    return ev.DeformedState(BLOCK.vertices * [factor, 1.0, 1.0], stress, opening=0.019)


def fingers() -> tuple[ev.FingerContact, ev.FingerContact]:
    return tuple(
        ev.FingerContact(
            name,
            positions=np.array([[0.0, side * 0.019, 0.0]]),
            normals=np.array([[0.0, -side, 0.0]]),
            forces=np.array([[0.0, -side, 0.3]]),
        )
        for name, side in zip(ev.FINGER_NAMES, (1.0, -1.0), strict=True)
    )


def held() -> ev.GraspEvaluation:
    """A grasp with everything: two lower bounds along the first directions, one direction without an angular number."""
    directions = sphere_directions()
    linear = np.arange(10.0, 26.0)
    angular = np.linspace(400.0, 700.0, 16)
    angular[3] = np.nan
    reasons = [""] * 16
    reasons[3] = "no solution"
    turned = 1e-3 * (1.0 + np.arange(64.0).reshape(16, 4) / 64.0)
    squeezed = np.array([1.0, 2.0, np.nan])
    time = np.array([0.0, 0.02, 0.04])
    return ev.GraspEvaluation(
        0,
        GRASPS[0].id,
        message="picked up and held",
        features=ev.GraspFeatures(0.01, 0.002, 1.0, 0.011, 0.001, 0.038, math.pi / 2.0),
        metrics=ev.GraspMetrics(True, 2000.0, 1e-3, 2e-4, float(linear.mean()), math.nan, float(turned.max())),
        target_force=2.0,
        applied_force=2.01,
        contacts=fingers(),
        slip_distance=1e-4,
        holding_time=4.0,
        pickup=ev.PickupCourse(
            time, np.array([3, 4, 5]), 0.019 + time, time, time + 1.0, time + 2.0,
            np.array([np.nan, 0.0, 1e-4]), 1e3 * time,
        ),
        fields={"pre_contact": stretched(1.0), "at_target_force": stretched(1.05), "post_pickup": stretched(1.1)},
        linear_acceleration=ev.AccelerationResult(
            directions, linear, linear - 5.0, np.arange(16) < 2, [""] * 16
        ),
        angular_acceleration=ev.AccelerationResult(
            directions, angular, angular - 50.0, np.zeros(16, dtype=bool), reasons
        ),
        reorientation=ev.ReorientationResult(
            directions, 3.0, turned, turned / 2.0, 1e6 * turned, turned / 10.0, [""] * 16, {(15, 3): stretched(1.2)}
        ),
        squeeze=ev.SqueezeResult(
            squeezed, 0.019 - squeezed / 1e3, squeezed / 1e3, 1e3 * squeezed, squeezed / 1e4,
            [fingers(), fingers()], [stretched(1.01), stretched(1.02)], "at 2.5 N: the object slipped out",
        ),
    )  # fmt: skip


def missed(index: int, code: ResultCode, message: str) -> ev.GraspEvaluation:
    return ev.GraspEvaluation(index, GRASPS[index].id, code=code, message=message, target_force=1.0)


def write_log(
    directory: Path, *, with_mesh: bool = True, with_fields: bool = True, finished: int = 3, close: bool = True
) -> Path:
    """Write the log and return its file.

    Args:
        directory: Where.
        with_mesh: Whether the tetrahedra are inside.
        with_fields: Whether the results have their fields over the mesh.
        finished: Of how many grasps there is a result.
        close: Whether the log is closed; otherwise it ends as if its writer had been killed.
    """
    options = ev.EvaluationOptions(experiments=EXPERIMENTS, return_fields=True, pickup_hold_time=4.0)
    gripper = load_gripper()
    request = EvaluationRequest(
        object=object_to_message(RegisteredObject("block"), MATERIAL, "block & co"),
        grasps=[grasp_to_message(grasp) for grasp in GRASPS],
        options=options_to_message(options),
    )
    request.options.pickup_hold_time = 0.0  # left to the evaluator
    results = [held(), missed(1, ResultCode.DROPPED, "it slipped out"), missed(2, ResultCode.NO_CONTACT, "beside it")]
    facts = provenance("cpu", {}, gripper, options) | {"version.defgrasp_ros": "1.2.3"}
    files = run_attachments(BLOCK, gripper) if with_mesh else []
    log = RunLog(directory, "run", list(TOPICS.values()), facts, files)
    log.write("/evaluator/request", request, START)
    for step in range(5):
        _write_sample(log, step)
    for result in results[:finished]:
        result = result if with_fields else result.without_fields()
        log.write("/evaluator/evaluations", evaluation_to_message(result, Time(sec=1)), START)
    log.close()
    path = directory / "run" / "run_0.mcap"
    if not close:
        path.write_bytes(path.read_bytes()[:-CUT_OFF])
    return path


def _write_sample(log: RunLog, step: int) -> None:
    time = START + step * 20_000_000
    forces = zip(ev.FINGER_NAMES, (1.0, 2.0), strict=True)
    contacts = [FingerContact(name=name, normal_force=force) for name, force in forces]
    log.write("/evaluator/contacts", ContactState(fingers=contacts, platform_force=0.5, grasp_index=0), time)
    joints = JointState(name=[f"{name}_joint" for name in ev.FINGER_NAMES], position=[0.02 - 1e-3 * step] * 2)
    joints.header.frame_id = GRASPS[0].id
    log.write("/evaluator/joint_states", joints, time)
