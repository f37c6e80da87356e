"""The topics of the evaluator, by names relative to the node, with their quality of service."""

from __future__ import annotations

from defgrasp_interfaces.msg import ContactState, EvaluationRequest, EvaluatorStatus, GraspEvaluation
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from defgrasp_ros.recording import Topic

STATUS = Topic("~/status", EvaluatorStatus, depth=1, latched=True)
"""What the evaluator is doing: on change, and once a second."""

JOINT_STATES = Topic("~/joint_states", JointState, depth=100)
"""Finger joints of each running grasp."""

CONTACTS = Topic("~/contacts", ContactState, depth=100)
"""Contact points of each running grasp."""

EVALUATIONS = Topic("~/evaluations", GraspEvaluation, depth=50, latched=True)
"""Each grasp's result as soon as it is known, without fields over the mesh."""

REQUEST = Topic("~/request", EvaluationRequest, depth=1, latched=True)
"""The request of a run; only in its log."""

PUBLISHED = (STATUS, JOINT_STATES, CONTACTS, EVALUATIONS)
LOGGED = (*PUBLISHED, REQUEST)


def qos_profile(topic: Topic) -> QoSProfile:
    """Return the quality of service with which a topic is published."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


def relative_name(topic: Topic) -> str:
    """Return the name without what makes it private or absolute, e.g. ``joint_states``."""
    return topic.name.lstrip("~/")
