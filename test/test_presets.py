"""Options, their ranges, and the presets of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import yaml

from defgrasp_ros.commands.evaluation_options import evaluation_options
from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError
from defgrasp_ros.evaluation import EvaluationOptions, Experiment
from defgrasp_ros.option import options_of
from defgrasp_ros.presets import load_preset, preset_names

OPTIONS = options_of(EvaluationOptions)
NUMBERS = [name for name, option in OPTIONS.items() if option.kind is not bool]


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_paper_is_the_default():
    """The preset of the paper names every constant, and each has its default."""
    assert load_preset("paper") == EvaluationOptions()
    assert set(yaml.safe_load(config_file("presets/paper.yaml").read_text())) == set(OPTIONS)


def test_code_differs_where_the_papers_do():
    """The preset of DefGraspSim's code has its jerk, its angular limit, and its snapshots in motion."""
    code = load_preset("defgraspsim_code")
    assert (code.linear_jerk, code.max_angular_acceleration, code.angular_jerk) == (100.0, 1250.0, 2500.0)
    assert not code.reorientation_settles
    assert code.acceleration_time_step == pytest.approx(1.0 / 1500.0, rel=1e-12)


def test_given_options_win_over_the_preset():
    """What is given counts; what is not comes from the preset, and from the defaults where that is silent."""
    options = evaluation_options("defgraspsim_code", linear_jerk=7.0, angular_jerk=None, experiments="squeeze")
    assert options.linear_jerk == 7.0
    assert options.max_angular_acceleration == 1250.0
    assert options.experiments == {Experiment.PICKUP, Experiment.SQUEEZE}


def test_preset_of_the_user_is_a_file(tmp_path):
    """A path of a .yaml file is a preset, also with experiments."""
    path = write(tmp_path / "gentle.yaml", "squeeze_force: 1e1\nexperiments: [squeeze, pickup]\n")
    options = load_preset(path)
    assert options.squeeze_force == 10.0  # a text for YAML, which wants 1.0e+1
    assert options.experiments == {Experiment.PICKUP, Experiment.SQUEEZE}
    assert load_preset(write(tmp_path / "empty.yaml", "# nothing\n")) == EvaluationOptions()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("linear_jerk: -1", r"bad\.yaml: options\.linear_jerk = -1 m/s\^3 is outside \[1, 100000\] m/s\^3"),
        ("linear_jerk: fast", r"options\.linear_jerk = 'fast' is not a number"),
        ("linear_yerk: 1", r"option 'linear_yerk' is unknown; known are .*linear_jerk"),
        ("squeeze_sample_count: 2.5", r"options\.squeeze_sample_count = 2\.5 is not a whole number"),
        ("reorientation_settles: 3", r"options\.reorientation_settles = 3 is neither true nor false"),
        ("experiments: [shake]", r"options\.experiments: 'shake' is unknown; known are pickup, .*squeeze, all"),
        ("experiments: 3", r"options\.experiments = 3 is no list of names"),
        ("- linear_jerk", "holds a list"),
        ("a: [", "is not YAML"),
    ],
)
def test_faulty_preset_is_refused(tmp_path, text, expected):
    """The text names file, option, value and what is allowed."""
    with pytest.raises(InvalidOptionsError, match=expected):
        load_preset(write(tmp_path / "bad.yaml", text))


def test_unknown_preset_names_the_known(tmp_path):
    """Names and files that do not exist are told apart."""
    with pytest.raises(NotFoundError, match="preset 'papper' is unknown; known are defgraspsim_code, paper"):
        load_preset("papper")
    with pytest.raises(NotFoundError, match="preset file .*none.yaml' does not exist"):
        load_preset(tmp_path / "none.yaml")
    assert preset_names() == ["defgraspsim_code", "paper"]


@pytest.mark.parametrize("name", NUMBERS)
def test_option_is_checked_at_both_ends(name):
    """The ends of the range are taken, unless it is open there; what is beyond is refused with option and unit."""
    option = OPTIONS[name]
    for end in (option.low, option.high):
        if not (end == option.low and option.low_open):
            assert getattr(EvaluationOptions(**{name: end}), name) == end
    beyond = [option.low if option.low_open else option.low - 1.0, 2.0 * option.high, float("nan")]
    for value in beyond:
        with pytest.raises(InvalidOptionsError, match=f"options.{name} = .*{'' if option.unit == '-' else ' '}"):
            EvaluationOptions(**{name: value})


def test_every_number_says_its_unit_and_range():
    """The help of a number has unit and range, and every field but the experiments and the fields is an option."""
    for name in NUMBERS:
        assert f" [{OPTIONS[name].unit}], in " in OPTIONS[name].text
    fields = {field.name for field in dataclasses.fields(EvaluationOptions)}
    assert fields - set(OPTIONS) == {"experiments", "return_fields"}


def test_page_of_the_protocol_lists_every_constant():
    """docs/protocol.md has each constant with its default, meaning, unit and range."""
    page = (Path(__file__).resolve().parents[1] / "docs" / "protocol.md").read_text()
    for name, option in OPTIONS.items():
        assert f"| `{name}` | {option.default_text} | {option.text} |\n" in page
