"""What a client raises."""

from __future__ import annotations

from defgrasp_interfaces.msg import Result

from defgrasp_ros.errors import DefgraspError, ResultCode


class EvaluatorGoneError(DefgraspError):
    """No evaluator is running, or it ended before it answered."""


def refusal(result: Result) -> DefgraspError:
    """Return the error that a result stands for, of the class whose code it has."""
    classes = {error.code: error for error in reversed(_with_subclasses(DefgraspError))}
    error = classes.get(result.code, DefgraspError)(result.message)
    error.code = ResultCode(result.code)  # also where no class has this code
    return error


def _with_subclasses(error: type[DefgraspError]) -> list[type[DefgraspError]]:
    return [error, *(each for subclass in error.__subclasses__() for each in _with_subclasses(subclass))]
