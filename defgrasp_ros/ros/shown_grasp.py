"""The one grasp of a run that viewers show: its joints, wrenches, points and markers belong together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

from defgrasp_ros.evaluation import GraspSample
from defgrasp_ros.gripper import Gripper
from defgrasp_ros.mesh.tet_mesh import TetMesh
from defgrasp_ros.periodic import Periodic
from defgrasp_ros.ros.fields import time_message
from defgrasp_ros.ros.joint_states import sample_to_joint_state
from defgrasp_ros.ros.markers import GraspMarkers
from defgrasp_ros.ros.outputs import Outputs
from defgrasp_ros.ros.point_cloud import fields_to_point_cloud
from defgrasp_ros.ros.topics import JOINT_STATES, MARKERS, OBJECT_POINTS, WRENCHES
from defgrasp_ros.ros.wrenches import sample_to_wrenches


class ShownGrasp:
    """Sends the topics of one grasp; another takes its place when it is finished, or an experiment goes on without it.

    Args:
        outputs: Takes the messages.
        mesh: Of the object.
        gripper: Of the grasps.
        parameters: Values of the node's parameters: which grasp is shown, and the rates.
    """

    def __init__(self, outputs: Outputs, mesh: TetMesh, gripper: Gripper, parameters: Mapping) -> None:
        self._outputs = outputs
        self._gripper = gripper
        self._markers = GraspMarkers(mesh, gripper)
        self._asked = parameters["publish.grasp"]
        self._points_due = Periodic(1.0 / parameters["publish.field_rate"])
        self._markers_due = Periodic(1.0 / parameters["publish.marker_rate"])
        self._index: int | None = None
        self._moment: tuple = (None, None, None)

    def finish(self, grasp_index: int) -> None:
        """Take note that all is known about a grasp."""
        if grasp_index == self._index:
            self._index = None

    def choose(self, samples: Sequence[GraspSample]) -> GraspSample | None:
        """Return what is shown of these samples; None while the grasp waits for others, or the one asked for does."""
        if self._asked:
            return next((each for each in samples if self._asked in (each.grasp_id, str(each.grasp_index))), None)
        shown = next((each for each in samples if each.grasp_index == self._index), None)
        _, experiment, _ = self._moment
        if shown is None and (self._index is None or samples[0].experiment != experiment):
            return samples[0]
        return shown

    def send(self, samples: Sequence[GraspSample], time: int) -> None:
        """Send what is wanted and due.

        Args:
            samples: Every running grasp at one instant.
            time: Start of the run plus simulated time [ns].
        """
        sample = self.choose(samples)
        if sample is None:
            return
        moment = (sample.grasp_index, sample.experiment, sample.phase)
        is_new, self._moment, self._index = moment != self._moment, moment, sample.grasp_index
        outputs, stamp = self._outputs, time_message(time)
        if outputs.wanted(JOINT_STATES):
            outputs.send(JOINT_STATES, sample_to_joint_state(sample, self._gripper, stamp), time)
        if any(map(outputs.wanted, WRENCHES)):
            for topic, wrench in zip(WRENCHES, sample_to_wrenches(sample, stamp), strict=True):
                outputs.send(topic, wrench, time)
        read_fields = cache(sample.read_fields)
        if outputs.wanted(OBJECT_POINTS) and self._points_due.is_due(sample.time):
            self._points_due.done(sample.time)
            outputs.send(OBJECT_POINTS, fields_to_point_cloud(read_fields(), stamp), time)
        if outputs.wanted(MARKERS) and (is_new or self._markers_due.is_due(sample.time)):
            self._markers_due.done(sample.time)
            outputs.send(MARKERS, self._markers.draw(sample, read_fields(), stamp), time)
