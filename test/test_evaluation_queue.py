"""The queue of the evaluator, what ends a run early, and the feedback, each on its own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from threading import Event

import pytest

pytest.importorskip("rclpy")
msg = pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")

from defgrasp_interfaces.action import EvaluateGrasps  # noqa: E402

from defgrasp_ros.errors import ResultCode  # noqa: E402
from defgrasp_ros.ros.evaluation_queue import EvaluationJob, EvaluationQueue  # noqa: E402
from defgrasp_ros.ros.evaluation_run import full_answer  # noqa: E402
from defgrasp_ros.ros.goal_feedback import GoalFeedback  # noqa: E402
from defgrasp_ros.stop_signal import StopSignal  # noqa: E402

TIMEOUT = 30.0


class Worker:
    """A queue whose jobs run until they are stopped, or all are let go."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.let_go = Event()
        self.queue = EvaluationQueue(self.evaluate, lambda job: f"{name_of(job)} gave up")

    def evaluate(self, job: EvaluationJob) -> str:
        self.begun.append(name_of(job))
        while not (job.stop.is_set() or self.let_go.wait(1e-3)):
            pass
        return f"{name_of(job)} {job.stop.code.name}"

    def submit(self, name: str) -> tuple[EvaluationJob, Event, Event]:
        """Return a job, what tells that it has begun, and what tells that it is answered."""
        begun, answered = Event(), Event()
        job = EvaluationJob(msg.EvaluationRequest(gripper=name), on_start=begun.set)
        job.answer.add_done_callback(lambda _: answered.set())
        self.queue.submit(job)
        return job, begun, answered


def name_of(job: EvaluationJob) -> str:
    return job.request.gripper


@pytest.fixture
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.queue.close()


def test_jobs_begin_when_resumed_in_the_order_of_their_coming(worker: Worker) -> None:
    """A paused queue begins nothing; then one follows the other."""
    jobs = [worker.submit(name) for name in "abc"]
    assert worker.queue.waiting_count == 3 and not worker.begun
    worker.let_go.set()
    worker.queue.resume()
    assert all(answered.wait(TIMEOUT) for _, _, answered in jobs)
    assert worker.begun == ["a", "b", "c"]
    assert [job.answer.result() for job, _, _ in jobs] == ["a OK", "b OK", "c OK"]


def test_room_is_counted_behind_the_running_one(worker: Worker) -> None:
    """With room for none, one may run; with room for one, a second may wait."""
    worker.queue.resume()
    assert not worker.queue.is_full(0)
    _, begun, _ = worker.submit("a")
    assert begun.wait(TIMEOUT)
    assert worker.queue.is_full(0) and not worker.queue.is_full(1)
    worker.submit("b")
    assert worker.queue.is_full(1)


def test_ending_one_job_leaves_the_others(worker: Worker) -> None:
    """A waiting one is answered at once, a running one with what it has; the next begins."""
    worker.queue.resume()
    first, begun, first_answered = worker.submit("a")
    waiting, _, answered = worker.submit("b")
    last, last_begun, _ = worker.submit("c")
    assert begun.wait(TIMEOUT)
    worker.queue.end(waiting, ResultCode.CANCELED, "no longer wanted")
    assert answered.is_set() and waiting.answer.result() == "b gave up"
    assert worker.queue.end_running(ResultCode.CANCELED, "stopped")
    assert first_answered.wait(TIMEOUT) and first.answer.result() == "a CANCELED"
    assert last_begun.wait(TIMEOUT) and worker.begun == ["a", "c"]


def test_closed_queue_answers_everybody(worker: Worker) -> None:
    """The running one ends, those that wait give up, and so does one that comes too late."""
    worker.queue.resume()
    _, begun, _ = worker.submit("a")
    waiting, _, _ = worker.submit("b")
    assert begun.wait(TIMEOUT)
    worker.queue.close()
    late, _, _ = worker.submit("c")
    assert [job.answer.result() for job in (waiting, late)] == ["b gave up", "c gave up"]
    assert not worker.queue.end_running(ResultCode.CANCELED, "nothing is there")


def test_first_reason_to_stop_counts() -> None:
    """A time limit that passes does not change why a run was canceled, nor the other way round."""
    canceled, late, free = StopSignal(), StopSignal(), StopSignal()
    canceled.set(ResultCode.CANCELED, "not wanted")
    canceled.limit(1e-9)
    assert canceled.is_set() and (canceled.code, canceled.reason) == (ResultCode.CANCELED, "not wanted")
    late.limit(1e-9)
    assert late.is_set()
    late.set(ResultCode.CANCELED, "too late")
    assert late.code == ResultCode.TIMEOUT and "time limit of 1e-09 s" in late.reason
    assert not free.is_set() and (free.code, free.reason) == (ResultCode.OK, "")


def test_every_grasp_of_an_unfinished_run_has_an_answer() -> None:
    """What is known stays; the others get code, reason and the id of the request, which may be empty."""
    request = msg.EvaluationRequest(grasps=[msg.Grasp(id="a"), msg.Grasp(), msg.Grasp(id="c")])
    known = {0: msg.GraspEvaluation(grasp_id="a", result=msg.Result(code=ResultCode.OK))}
    answer = full_answer(request, ResultCode.TIMEOUT, "too late", known)
    found = [(each.grasp_index, each.grasp_id, each.result.code) for each in answer.evaluations]
    assert found == [(0, "a", ResultCode.OK), (1, "", ResultCode.TIMEOUT), (2, "c", ResultCode.TIMEOUT)]
    assert answer.result.code == ResultCode.TIMEOUT and "too late" in answer.result.message
    known |= {each.grasp_index: each for each in answer.evaluations[1:]}
    for each in known.values():
        each.result.code = int(ResultCode.DROPPED)
    assert full_answer(request, ResultCode.TIMEOUT, "too late", known).result.code == ResultCode.OK


def status(**values: object) -> msg.EvaluatorStatus:
    return msg.EvaluatorStatus(state=msg.EvaluatorStatus.STATE_RUNNING, run_id="run", **values)


def test_feedback_is_sparse_but_leaves_nothing_out() -> None:
    """A new phase and an evaluation are told at once, that a phase goes on is not; after its end it hears nothing."""
    sent: list[EvaluateGrasps.Feedback] = []
    feedback = GoalFeedback(sent.append)
    feedback.on_evaluation(status(), msg.GraspEvaluation(grasp_id="of another goal"))
    assert not sent
    feedback.start()
    feedback.on_status(status(phase=3))
    feedback.on_status(status(phase=3))
    feedback.on_status(status(phase=4))
    assert [each.status.phase for each in sent] == [3, 4]
    assert all(math.isnan(each.time_remaining) for each in sent)
    feedback.on_evaluation(status(phase=4, progress=0.5), msg.GraspEvaluation(grasp_id="a"))
    assert [each.grasp_id for each in sent[-1].finished] == ["a"] and sent[-1].time_remaining >= 0.0
    feedback.end()
    feedback.on_status(status(phase=5))
    feedback.on_evaluation(status(phase=5), msg.GraspEvaluation(grasp_id="of the next goal"))
    assert len(sent) == 3
