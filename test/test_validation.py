"""The product's validation suite: its cases hold, and it tells when one does not."""

import json
import math
import sys

import pytest
import warp as wp

from defgrasp_ros import cli
from defgrasp_ros.validation import suite
from defgrasp_ros.validation.case import Experiment, absolute, relative, vanishing


def parameters():
    """Every experiment; those outside the quick set are slow."""
    result = []
    for experiment in suite.experiments(quick=False, cuda=wp.is_cuda_available()):
        marks = [] if experiment.quick else [pytest.mark.slow, pytest.mark.timeout(900)]
        result.append(pytest.param(experiment, id=experiment.name, marks=marks))
    return result


@pytest.mark.parametrize("experiment", parameters())
def test_cases_hold(experiment):
    """Every case of the experiment is within its tolerance of the reference."""
    cases = suite.measure(experiment, "cpu")
    failed = [f"{c.name}: {c.measured:g}, not {c.reference:g} ({c.source})" for c in cases if not c.passed]
    assert cases and not failed, "\n".join(failed)


def test_experiments_have_names_of_their_own():
    """No two experiments share a name, and the quick set is a part of the whole."""
    every = suite.experiments(quick=False, cuda=True)
    quick = suite.experiments(quick=True, cuda=True)
    assert len({experiment.name for experiment in every}) == len(every) > len(quick) > 10
    assert set(quick) < set(every)
    assert all(not e.compares_devices for e in suite.experiments(quick=False, cuda=False))


def test_errors_are_relative_or_absolute():
    """A case passes up to its tolerance; what is not a number does not pass."""
    assert relative("a", 1.1, 1.0, 0.11, "").passed and not relative("a", 1.1, 1.0, 0.09, "").passed
    assert relative("a", -2.2, -2.0, 1.0, "").error == pytest.approx(0.1)
    assert absolute("a", 2.2, 2.0, 1.0, "").error == pytest.approx(0.2)
    assert vanishing("a", -0.3, 1.0, "").error == pytest.approx(0.3)
    assert not vanishing("a", math.nan, 1.0, "").passed


def good(device):
    yield relative("good", 2.0, 2.0, 0.1, "itself")


def wrong(device):
    yield relative("wrong", 2.0, 1.0, 0.1, "itself")


def broken(device):
    yield relative("before", 1.0, 1.0, 0.1, "itself")
    raise RuntimeError("it broke")


@pytest.fixture
def validate(monkeypatch, capsys):
    """Runs ``defgrasp validate`` on made-up experiments; returns exit status, standard output and error."""

    def run(*measures, arguments=("--json",)):
        made_up = [Experiment(measure.__name__, measure) for measure in measures]
        monkeypatch.setattr(suite, "experiments", lambda **_: made_up)
        monkeypatch.setattr(sys, "argv", ["defgrasp", "validate", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, *capsys.readouterr()

    return run


def test_json_is_all_that_is_printed(validate):
    """Standard output holds the document and nothing else; everything right is exit status 0."""
    status, output, _ = validate(good)
    assert status == 0
    case = {"name": "good", "measured": 2.0, "reference": 2.0, "error": 0.0, "tolerance": 0.1}
    assert json.loads(output) == {"cases": [case | {"passed": True, "source": "itself"}]}


def test_a_failed_case_gives_exit_status_1(validate):
    """One case beyond its tolerance fails the run; the others are there."""
    status, output, _ = validate(wrong, good)
    assert status == 1
    assert [case["passed"] for case in json.loads(output)["cases"]] == [False, True]


def test_an_experiment_that_raises_is_a_failed_case(validate):
    """Its text is the source, what it measured before is kept, and the next experiment runs."""
    status, output, _ = validate(broken, good)
    before, failed, after = json.loads(output)["cases"]
    assert status == 1
    assert before["passed"] and after["passed"] and not failed["passed"]
    assert failed["name"] == "broken" and failed["source"] == "RuntimeError: it broke" and failed["measured"] is None


def test_the_table_shows_every_case(validate):
    """Without --json a table with a row per case and a count appear."""
    status, output, _ = validate(good, wrong, arguments=())
    assert status == 1
    for word in ("case", "measured", "reference", "error", "tolerance", "source", "good", "wrong"):
        assert word in output
    assert "2 cases, 1 failed" in output
