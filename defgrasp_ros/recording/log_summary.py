"""What is in a log, without keeping its messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.recording.log_reader import LoggedTopic, LogReader
from defgrasp_ros.recording.topic import NANOSECONDS


@dataclass(frozen=True)
class Outcome:
    """How one grasp of a run ended."""

    grasp_index: int
    grasp_id: str
    code: ResultCode
    message: str


@dataclass
class LogSummary:
    """What is in a log."""

    path: Path
    size: int
    """Of the file [B]."""
    complete: bool
    """Whether the log was closed."""
    topics: list[LoggedTopic]
    counts: Counter[str]
    """Messages by topic [-]."""
    start_time: int
    """When the first message was recorded [ns since the epoch]; 0 in an empty log."""
    end_time: int
    """The same of the last message."""
    provenance: dict[str, str]
    """How the run was made."""
    statistics: dict[str, str]
    """How the recording went."""
    attachments: dict[str, int]
    """Sizes of the files inside by name [B]."""
    object_name: str = ""
    """As in the request."""
    grasp_count: int = 0
    """Grasps in the request [-]."""
    outcomes: list[Outcome] = field(default_factory=list)
    """Of the evaluated grasps, by index."""

    @property
    def duration(self) -> float:
        """From the first to the last message [s]."""
        return (self.end_time - self.start_time) / NANOSECONDS

    def document(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        return {
            "path": str(self.path),
            "size": self.size,
            "complete": self.complete,
            "start_time": self.start_time,
            "end_time": self.end_time,
            "duration": self.duration,
            "message_count": self.counts.total(),
            "topics": [
                {
                    "name": topic.name,
                    "type": topic.type_name,
                    "message_count": self.counts[topic.name],
                    "qos": topic.qos,
                    "type_hash": topic.type_hash,
                }
                for topic in self.topics
            ],
            "run": self.provenance,
            "recording": self.statistics,
            "attachments": self.attachments,
            "object_name": self.object_name,
            "grasp_count": self.grasp_count,
            "outcomes": [
                {
                    "grasp_index": outcome.grasp_index,
                    "grasp_id": outcome.grasp_id,
                    "result": {
                        "code": int(outcome.code),
                        "name": outcome.code.name,
                        "message": outcome.message,
                    },
                }
                for outcome in self.outcomes
            ],
        }


def summarize_log(path: Path) -> LogSummary:
    """Read a log, given as file or bag folder, up to its last complete record.

    Raises:
        NotFoundError: If there is no such log.
        RecordingError: If it cannot be read, or is no MCAP log of ROS messages.
    """
    reader = LogReader(path)
    counts: Counter[str] = Counter()
    start_time = end_time = 0
    object_name, grasp_count = "", 0
    outcomes: dict[int, Outcome] = {}
    for message in reader:
        start_time, end_time = start_time or message.log_time, message.log_time
        counts[message.topic.name] += 1
        if message.topic.type_name == "defgrasp_interfaces/msg/EvaluationRequest":
            request = reader.decode(message)
            object_name, grasp_count = request.object.name, len(request.grasps)
        elif message.topic.type_name == "defgrasp_interfaces/msg/GraspEvaluation":
            each = reader.decode(message)
            code = ResultCode(each.result.code)
            outcomes[each.grasp_index] = Outcome(each.grasp_index, each.grasp_id, code, each.result.message)
    return LogSummary(
        path=reader.path,
        size=reader.path.stat().st_size,
        complete=reader.complete,
        topics=sorted(reader.topics.values(), key=lambda topic: topic.name),
        counts=counts,
        start_time=start_time,
        end_time=end_time,
        provenance=reader.provenance,
        statistics=reader.statistics,
        attachments={name: len(attachment.data) for name, attachment in reader.attachments.items()},
        object_name=object_name,
        grasp_count=grasp_count,
        outcomes=[outcomes[index] for index in sorted(outcomes)],
    )
