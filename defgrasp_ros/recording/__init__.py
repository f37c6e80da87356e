"""The log of each run: an MCAP file that rosbag2, rosbags and Foxglove open, written so that a crash loses little."""

from defgrasp_ros.recording.provenance import provenance
from defgrasp_ros.recording.read_log import LoggedMessage, LoggedRun, read_log
from defgrasp_ros.recording.run_log import RunLog
from defgrasp_ros.recording.topic import Topic

__all__ = ["LoggedMessage", "LoggedRun", "RunLog", "Topic", "provenance", "read_log"]
