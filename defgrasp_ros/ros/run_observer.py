"""Publishes and logs what happens while a run simulates."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from defgrasp_interfaces import msg
from rosgraph_msgs.msg import Clock

from defgrasp_ros.evaluation import EvaluationObserver, GraspEvaluation, GraspSample, Progress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.recording.topic import NANOSECONDS
from defgrasp_ros.ros.fields import time_message
from defgrasp_ros.ros.joint_states import sample_to_joint_state
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.result_conversion import evaluation_to_message
from defgrasp_ros.ros.robot_description import send_robot_description
from defgrasp_ros.ros.shown_grasp import ShownGrasp
from defgrasp_ros.ros.state_conversion import sample_to_contact_state
from defgrasp_ros.ros.status_reporter import StatusReporter
from defgrasp_ros.ros.topics import ALL_JOINT_STATES, CLOCK, CONTACTS, EVALUATIONS, SAMPLED


class RunObserver(EvaluationObserver):
    """Follows one run.

    Args:
        outputs: Takes the messages.
        status: Is told how far the run is.
        grasps: The simulated grasps by index in the request, in the order of simulation.
        mesh: Of the object.
        gripper: Of all grasps.
        parameters: Values of the node's parameters, of which those below ``publish`` count here.
        return_fields: Whether the answer has fields over the mesh; what is published never has, the log always.
        start_time: The node's clock at the start of the run [ns]; stamps are this plus simulated time.
    """

    def __init__(
        self,
        outputs: Outputs,
        status: StatusReporter,
        grasps: Mapping[int, Grasp],
        mesh: TetMesh,
        gripper: Gripper,
        parameters: Mapping,
        *,
        return_fields: bool,
        start_time: int,
    ) -> None:
        self.sample_interval = 1.0 / parameters["publish.sample_rate"]
        self.sample_direction = parameters["publish.direction"]
        self._outputs = outputs
        self._status = status
        self._identities = [{"grasp_index": index, "grasp_id": grasp.id} for index, grasp in grasps.items()]
        self._gripper = gripper
        self._shown = ShownGrasp(outputs, mesh, gripper, parameters)
        self._return_fields = return_fields
        self._start_time = start_time
        self.messages: dict[int, msg.GraspEvaluation] = {}
        """The evaluations so far, as the answer has them, by index in the request."""
        send_robot_description(outputs, gripper, start_time)

    def on_progress(self, progress: Progress) -> None:
        self._status.running(progress)
        if self._outputs.wanted(CLOCK):
            self._outputs.publish(CLOCK, Clock(clock=time_message(self._time(progress.simulated_time))))

    def wants_samples(self) -> bool:
        return any(self._outputs.wanted(topic) for topic in SAMPLED)

    def on_samples(self, samples: Sequence[GraspSample]) -> None:
        samples = [dataclasses.replace(sample, **self._identities[sample.grasp_index]) for sample in samples]
        time = self._time(samples[0].time)
        stamp = time_message(time)
        if self._outputs.wanted(ALL_JOINT_STATES):
            for sample in samples:
                self._outputs.send(ALL_JOINT_STATES, sample_to_joint_state(sample, self._gripper, stamp), time)
        if self._outputs.wanted(CONTACTS):
            for sample in samples:
                self._outputs.send(CONTACTS, sample_to_contact_state(sample, stamp), time)
        self._shown.send(samples, time)

    def wants_fields(self) -> bool:
        return self._outputs.is_logged(EVALUATIONS)

    def on_evaluation(self, evaluation: GraspEvaluation) -> None:
        evaluation = dataclasses.replace(evaluation, **self._identities[evaluation.grasp_index])
        self._shown.finish(evaluation.grasp_index)
        self.send_evaluation(evaluation)

    def send_evaluation(self, evaluation: GraspEvaluation) -> None:
        """Publish an evaluation that has its index in the request, log it, and keep it for the answer."""
        time = self._time(evaluation.end_time)
        without_fields = evaluation_to_message(evaluation.without_fields(), time_message(time))
        complete = evaluation_to_message(evaluation, time_message(time))
        self._outputs.publish(EVALUATIONS, without_fields)
        self._outputs.log(EVALUATIONS, complete, time)
        self.messages[evaluation.grasp_index] = complete if self._return_fields else without_fields
        self._status.finished(without_fields)

    def _time(self, simulated_time: float) -> int:
        return self._start_time + round(simulated_time * NANOSECONDS)
