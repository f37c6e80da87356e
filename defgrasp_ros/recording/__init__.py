"""The log of each run: an MCAP file that rosbag2, rosbags and Foxglove open, written so that a crash loses little."""

from defgrasp_ros.recording.attachments import Attachment, run_attachments
from defgrasp_ros.recording.log_reader import LoggedTopic, LogReader, RawMessage
from defgrasp_ros.recording.provenance import provenance
from defgrasp_ros.recording.read_log import LoggedMessage, LoggedRun, read_log
from defgrasp_ros.recording.run_inputs import RunInputs, run_inputs
from defgrasp_ros.recording.run_log import LogStatistics, RunLog
from defgrasp_ros.recording.topic import Topic

__all__ = [
    "Attachment",
    "LogReader",
    "LogStatistics",
    "LoggedMessage",
    "LoggedRun",
    "LoggedTopic",
    "RawMessage",
    "RunInputs",
    "RunLog",
    "Topic",
    "provenance",
    "read_log",
    "run_attachments",
    "run_inputs",
]
