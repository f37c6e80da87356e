"""Cost of the messages about a running grasp: to read the state, to build the message, to serialise it, and its size.

Run: ``python benchmarks/messages.py`` (half a minute). Each number is the median over repetitions, in processor time of
the thread. A block of several resolutions is squeezed a little; then its state is sampled as the node does.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.serialization import serialize_message

from defgrasp_ros.evaluation import EvaluationObserver, EvaluationOptions, GraspSample
from defgrasp_ros.experiments.evaluate import evaluate_grasps
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.ros.fields import time_message
from defgrasp_ros.ros.joint_states import sample_to_joint_state
from defgrasp_ros.ros.markers import GraspMarkers
from defgrasp_ros.ros.point_cloud import fields_to_point_cloud
from defgrasp_ros.ros.state_conversion import sample_to_contact_state
from defgrasp_ros.ros.wrenches import sample_to_wrenches

CELLS = (4, 8, 12)
"""Of the block, along each edge."""
REPETITIONS = 30
STAMP = time_message(0)
HAND = load_gripper()
OPTIONS = EvaluationOptions(squeeze_time=0.02, time_step=0.01)


def milliseconds(work: Callable[[], object]) -> float:
    """Median processor time of some work [ms]; the first call is not counted."""
    work()
    times = []
    for _ in range(REPETITIONS):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return 1e3 * statistics.median(times)


class Stopwatch(EvaluationObserver):
    """Measures at one sample, in the midst of the squeeze, and ends the run."""

    def __init__(self, model: ObjectModel):
        self.sample_interval = OPTIONS.squeeze_time
        self._markers = GraspMarkers(model.mesh, HAND)
        self._done = False

    def on_samples(self, samples: Sequence[GraspSample]) -> None:
        (sample,) = samples
        if self._done or not all(contact.count for contact in sample.contacts):
            return
        self._done = True
        fields = sample.read_fields()
        contacts = sum(contact.count for contact in sample.contacts)
        triangles = len(self._markers.mesh.surface_triangles)
        print(f"{len(fields.positions)} nodes, {triangles} triangles, {contacts} contacts")
        print(f"  {'fields':<14} read  {milliseconds(sample.read_fields):7.2f} ms")
        builders = {
            "joint_states": lambda: sample_to_joint_state(sample, HAND, STAMP),
            "contacts": lambda: sample_to_contact_state(sample, STAMP),
            "both wrenches": lambda: sample_to_wrenches(sample, STAMP),
            "object_points": lambda: fields_to_point_cloud(fields, STAMP),
            "markers": lambda: self._markers.draw(sample, fields, STAMP),
        }
        for name, build in builders.items():
            messages = build() if isinstance(build(), list) else [build()]
            size = sum(len(serialize_message(message)) for message in messages)
            serialise = milliseconds(lambda messages=messages: [serialize_message(message) for message in messages])
            times = f"build {milliseconds(build):7.2f} ms, serialise {serialise:7.2f} ms"
            print(f"  {name:<14} {times}, {size / 1e3:.1f} kB")

    def should_stop(self) -> bool:
        return self._done


def main() -> None:
    """Print one block of numbers for each resolution."""
    grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    for cells in CELLS:
        model = ObjectModel("block", box((0.03, 0.03, 0.03), (cells,) * 3), Material(youngs_modulus=1e5))
        evaluate_grasps(model, [grasp], HAND, OPTIONS, observer=Stopwatch(model))


if __name__ == "__main__":
    main()
