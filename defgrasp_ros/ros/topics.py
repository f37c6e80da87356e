"""The topics of the evaluator, by names relative to the node, with their quality of service.

``python -m defgrasp_ros.ros.topics`` prints them as the table of ``docs/topics.md``.
"""

from __future__ import annotations

from defgrasp_interfaces.msg import ContactState, EvaluationRequest, EvaluatorStatus, GraspEvaluation
from geometry_msgs.msg import WrenchStamped
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from defgrasp_ros.evaluation import FINGER_NAMES
from defgrasp_ros.recording import Topic

BURST = 100
"""Depth of topics with one message per grasp at a time: more than a batch has grasps, so that none is lost."""

STATUS = Topic(
    "~/status",
    EvaluatorStatus,
    1,
    latched=True,
    lease=3.0,
    description="What the evaluator is doing: on change, and once a second",
)
EVALUATIONS = Topic(
    "~/evaluations",
    GraspEvaluation,
    50,
    latched=True,
    description="Each grasp's result as soon as it is known; with fields over the mesh only in the log",
)
ROBOT_DESCRIPTION = Topic(
    "~/robot_description", String, 1, latched=True, description="URDF of the gripper on its virtual wrist"
)
JOINT_STATES = Topic("~/joint_states", JointState, 10, description="Fingers and wrist of the shown grasp")
ALL_JOINT_STATES = Topic(
    "~/all_joint_states",
    JointState,
    BURST,
    description="The same of every running grasp, one message each; `header.frame_id` is the grasp's id",
)
CONTACTS = Topic(
    "~/contacts", ContactState, BURST, description="Contact points and forces of every running grasp, one message each"
)
WRENCHES = tuple(
    Topic(
        f"~/{finger}/wrench",
        WrenchStamped,
        10,
        description=f"Force and moment of the shown grasp's {finger.replace('_', ' ')} on the object",
    )
    for finger in FINGER_NAMES
)
OBJECT_POINTS = Topic(
    "~/object_points",
    PointCloud2,
    2,
    description="Nodes of the shown grasp's object: `x y z` [m], `displacement` [m], `von_mises` [Pa]",
)
MARKERS = Topic(
    "~/markers",
    MarkerArray,
    1,
    latched=True,
    description="Picture of the shown grasp: surface coloured by stress, pads, grasp frame, contact forces, platform",
)
CLOCK = Topic(
    "/clock", Clock, 1, reliable=False, description="Time of the simulation, with parameter `publish.clock` only"
)
REQUEST = Topic("~/request", EvaluationRequest, 1, latched=True, description="The request of a run; only in its log")

SAMPLED = (JOINT_STATES, ALL_JOINT_STATES, CONTACTS, *WRENCHES, OBJECT_POINTS, MARKERS)
"""What the state of running grasps is read for."""
PUBLISHED = (STATUS, EVALUATIONS, ROBOT_DESCRIPTION, *SAMPLED)
LOGGED = (*PUBLISHED, REQUEST)


EVERY_FEEDBACK = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Of the feedback of the action: many grasps may end at the same instant."""


def qos_profile(topic: Topic) -> QoSProfile:
    """Return the quality of service with which a topic is published."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=topic.lease),
    )


def relative_name(topic: Topic) -> str:
    """Return the name without what makes it private or absolute, e.g. ``joint_states``."""
    return topic.name.lstrip("~/")


def topics_table() -> str:
    """Return every topic as a Markdown table."""
    lines = ["| Topic | Type | What | Quality of service |", "| --- | --- | --- | --- |"]
    for topic in (*LOGGED, CLOCK):
        durability = "transient local" if topic.latched else "volatile"
        reliability = "reliable" if topic.reliable else "best effort"
        quality = f"{reliability}, {durability}, depth {topic.depth}"
        lines.append(f"| `{topic.name}` | `{topic.type_name}` | {topic.description} | {quality} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(topics_table(), end="")
