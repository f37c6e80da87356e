"""Publishes and logs what happens while a run simulates."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from defgrasp_interfaces import msg

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import EvaluationObserver, GraspEvaluation, GraspSample, Progress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.ros.fields import NANOSECONDS, time_message
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.result_conversion import evaluation_to_message
from defgrasp_ros.ros.state_conversion import sample_to_contact_state, sample_to_joint_state
from defgrasp_ros.ros.status_reporter import StatusReporter
from defgrasp_ros.ros.stop_signal import StopSignal
from defgrasp_ros.ros.topics import CONTACTS, EVALUATIONS, JOINT_STATES


class RunObserver(EvaluationObserver):
    """Follows one run.

    Args:
        outputs: Takes the messages.
        status: Is told how far the run is.
        grasps: The simulated grasps by index in the request, in the order of simulation.
        start_time: The node's clock at the start of the run [ns]; stamps are this plus simulated time.
        sample_interval: Simulated time between two samples of a grasp [s].
        stop: Ends the run early when set.
    """

    def __init__(
        self,
        outputs: Outputs,
        status: StatusReporter,
        grasps: Mapping[int, Grasp],
        start_time: int,
        sample_interval: float,
        stop: StopSignal,
    ) -> None:
        self.sample_interval = sample_interval
        self._outputs = outputs
        self._status = status
        self._identities = [{"grasp_index": index, "grasp_id": grasp.id} for index, grasp in grasps.items()]
        self._start_time = start_time
        self._stop = stop
        self.messages: dict[int, msg.GraspEvaluation] = {}
        """The evaluations so far, with fields over the mesh, by index in the request."""

    def on_progress(self, progress: Progress) -> None:
        self._status.running(progress)

    def on_sample(self, sample: GraspSample) -> None:
        sample = dataclasses.replace(sample, **self._identities[sample.grasp_index])
        time = self._time(sample.time)
        for topic, convert in ((JOINT_STATES, sample_to_joint_state), (CONTACTS, sample_to_contact_state)):
            if self._outputs.wanted(topic):
                self._outputs.send(topic, convert(sample, time_message(time)), time)

    def on_evaluation(self, evaluation: GraspEvaluation) -> None:
        self.send_evaluation(self.in_request(evaluation))

    def should_stop(self) -> bool:
        return self._stop.is_set()

    def in_request(self, evaluation: GraspEvaluation) -> GraspEvaluation:
        """Return an evaluation with the index and the id that its grasp has in the request.

        One that ended early gets code and reason of what ended the run.
        """
        evaluation = dataclasses.replace(evaluation, **self._identities[evaluation.grasp_index])
        if evaluation.code == ResultCode.CANCELED:
            text = f"{evaluation.message}: {self._stop.reason}"
            evaluation = dataclasses.replace(evaluation, code=self._stop.code, message=text)
        return evaluation

    def send_evaluation(self, evaluation: GraspEvaluation) -> None:
        """Publish an evaluation that has its index in the request; the log gets it with its fields over the mesh."""
        without_fields = self.message(evaluation, with_fields=False)
        self._outputs.publish(EVALUATIONS, without_fields)
        message = self.messages[evaluation.grasp_index] = self.message(evaluation)
        self._outputs.log(EVALUATIONS, message, self._time(evaluation.simulated_time))
        self._status.finished(without_fields)

    def message(self, evaluation: GraspEvaluation, *, with_fields: bool = True) -> msg.GraspEvaluation:
        """Return the message of an evaluation, stamped with the time at which it ended."""
        stamp = time_message(self._time(evaluation.simulated_time))
        return evaluation_to_message(evaluation, stamp, with_fields=with_fields)

    def _time(self, simulated_time: float) -> int:
        return self._start_time + round(simulated_time * NANOSECONDS)
