"""The parameters of the evaluator: one table, for declarations, ``config/evaluator.yaml`` and the documentation.

``python -m defgrasp_ros.ros.parameters`` prints the YAML file; with ``--markdown``, the table of ``docs/ros.md``.
"""

from __future__ import annotations

import dataclasses
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from defgrasp_ros.checks import interval
from defgrasp_ros.errors import DefgraspError, InvalidOptionsError
from defgrasp_ros.evaluation import ALL_EXPERIMENTS, EvaluationObserver, EvaluationOptions, Experiment, in_order
from defgrasp_ros.gripper import DEFAULT_GRIPPER, load_gripper
from defgrasp_ros.mesh.tetrahedralize import MAX_TETRAHEDRA
from defgrasp_ros.option import options_of
from defgrasp_ros.presets import load_preset
from defgrasp_ros.ros.topics import LOGGED, relative_name

EXPERIMENT = "experiment."
"""Prefix of the parameters that stand in for options left 0 in a request."""


DEVICE_NAME = re.compile(r"cpu|cuda:\d+")


@dataclass(frozen=True)
class Parameter:
    """One row of the table; a change takes effect with the next request."""

    name: str
    default: bool | int | float | str | list[str]
    description: str
    unit: str = ""
    range: tuple[float, float] | None = None
    low_open: bool = False
    """Whether the lower end of the range itself is refused."""
    read_only: bool = False
    """Whether it is fixed when the node starts."""

    @property
    def text(self) -> str:
        """Description with unit and range."""
        unit = f" [{self.unit}]" if self.unit else ""
        bounds = f", in {interval(*self.range, self.low_open)}" if self.range else ""
        return f"{self.description}{unit}{bounds}{'; read-only' if self.read_only else ''}"

    @property
    def default_text(self) -> str:
        """The default as a parameter file has it."""
        return yaml.safe_dump(self.default, default_flow_style=True).splitlines()[0]

    @property
    def descriptor(self) -> ParameterDescriptor:
        """The row as ROS wants it."""
        descriptor = ParameterDescriptor(name=self.name, description=self.text, read_only=self.read_only)
        if self.range and isinstance(self.default, float):
            low, high = self.range
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        elif self.range:
            low, high = map(int, self.range)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor


def _experiment_parameters(options: EvaluationOptions) -> list[Parameter]:
    """The options that a request can leave out, with these defaults."""
    names = ", ".join((*Experiment, ALL_EXPERIMENTS))
    experiments = [str(experiment) for experiment in in_order(options.experiments)]
    rows = [Parameter(EXPERIMENT + "experiments", experiments, f"What is done with each grasp: {names}")]
    for name, option in options_of(EvaluationOptions).items():
        is_number = option.kind is not bool
        rows.append(
            Parameter(
                EXPERIMENT + name,
                getattr(options, name),
                option.meaning if is_number else f"{option.meaning}; a request can only switch it off",
                option.unit,
                (option.low, option.high) if is_number else None,
                option.low_open,
            )
        )
    return rows


NODE_PARAMETERS = (
    Parameter("autostart", True, "Whether the node configures and activates itself", read_only=True),
    Parameter("device", "cpu", "Where the simulation runs: cpu, cuda:0 ..."),
    Parameter("gripper", DEFAULT_GRIPPER, "Gripper of requests that name none: a file of config/grippers"),
    Parameter(
        "max_queued_goals",
        20,
        "Most goals and requests that wait behind the running one; more are rejected",
        range=(0, 10_000),
    ),
    Parameter("max_grasps", 1000, "Most grasps in one request; more are refused", range=(1, 1_000_000)),
    Parameter(
        "max_tetrahedra",
        MAX_TETRAHEDRA,
        "Most tetrahedra of an object; more are refused",
        range=(1, MAX_TETRAHEDRA),
    ),
    Parameter(
        "mesh_directories",
        "",
        "Folders from which mesh files may be read, with ':' between them; empty: all.",
    ),
    Parameter(
        "publish.sample_rate",
        1.0 / EvaluationObserver.sample_interval,
        "Joint states, contacts and wrenches per simulated second",
        "1/s",
        range=(0.1, 1000.0),
    ),
    Parameter(
        "publish.field_rate",
        10.0,
        "Point clouds per simulated second, at most as many as samples",
        "1/s",
        range=(0.01, 1000.0),
    ),
    Parameter(
        "publish.marker_rate",
        2.0,
        "Markers per simulated second, besides those when the phase or the shown grasp changes",
        "1/s",
        range=(0.01, 1000.0),
    ),
    Parameter(
        "publish.grasp",
        "",
        "Id of the grasp shown by joint states, wrenches, points and markers; empty: the first that runs",
    ),
    Parameter(
        "publish.direction",
        0,
        "Which of the 16 directions is published of the experiments that have them",
        range=(0, 15),
    ),
    Parameter("publish.clock", False, "Whether /clock tells the time of the simulation", read_only=True),
    Parameter("record.enabled", True, "Whether runs are logged; a request can ask for no log of its own run"),
    Parameter("record.directory", "", "Folder of the logs; empty: $ROS_HOME/defgrasp, or ~/.ros/defgrasp"),
    Parameter(
        "record.topics",
        "",
        "What is logged beside the request: names of topics with ',' between them, as status,evaluations; empty: all.",
    ),
    Parameter(
        "record.max_size",
        0.0,
        "Size at which a log ends, while the run goes on; 0: no limit",
        "MB",
        range=(0.0, 1e6),
    ),
    Parameter(
        "preset",
        "paper",
        "Where the experiment.* that are not given come from: a name in config/presets, or a .yaml file",
        read_only=True,
    ),
)

PARAMETERS = (*NODE_PARAMETERS, *_experiment_parameters(EvaluationOptions()))
"""The whole table, with the defaults of the preset ``paper``."""


def declare_parameters(node: Node) -> None:
    """Declare every parameter of the table; values outside their ranges are refused, now and later.

    Raises:
        InvalidParameterValueException: If a value that the node was started with is refused.
    """
    node.add_on_set_parameters_callback(_check)
    for parameter in NODE_PARAMETERS:
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor)
    for parameter in _experiment_parameters(load_preset(node.get_parameter("preset").value)):
        node.declare_parameter(parameter.name, parameter.default, parameter.descriptor)


def parameter_values(node: Node) -> dict[str, bool | int | float | str | list[str]]:
    """Return the present value of every parameter of the table."""
    return {parameter.name: node.get_parameter(parameter.name).value for parameter in PARAMETERS}


def experiment_defaults(values: dict) -> EvaluationOptions:
    """Return the options that apply where a request leaves them 0."""
    given = {name.removeprefix(EXPERIMENT): value for name, value in values.items() if name.startswith(EXPERIMENT)}
    return dataclasses.replace(EvaluationOptions(), **given)


def mesh_directories(values: dict) -> list[Path]:
    """Return the folders from which mesh files may be read; empty: all."""
    return [Path(folder) for folder in values["mesh_directories"].split(os.pathsep) if folder]


def log_directory(values: dict) -> Path:
    """Return the folder of the logs."""
    ros_home = os.environ.get("ROS_HOME") or "~/.ros"
    return Path(values["record.directory"] or f"{ros_home}/defgrasp").expanduser()


def logged_topics(values: dict) -> list[str]:
    """Return the relative names of the topics that are logged; empty: all.

    Raises:
        InvalidOptionsError: If there is no topic of such a name.
    """
    names = [name.strip().lstrip("~/") for name in values["record.topics"].split(",") if name.strip()]
    known = [relative_name(topic) for topic in LOGGED]
    for name in names:
        if name not in known:
            raise InvalidOptionsError(f"record.topics: there is no topic '{name}'; known: {', '.join(known)}")
    return names


def max_log_size(values: dict) -> int:
    """Return the size that a log does not exceed [B]; 0: no limit."""
    return round(values["record.max_size"] * 1e6)


def parameters_yaml() -> str:
    """Return the table as a parameter file with every default; the preset decides about what it leaves out."""
    lines = [
        "# Parameters of the evaluator with their defaults; pass a copy with --ros-args --params-file.",
        "# A change takes effect with the next request. What stands behind #: is the preset's unless it is given.",
        "/**:",
        "  ros__parameters:",
    ]
    group = ""
    for parameter in PARAMETERS:
        *path, name = parameter.name.split(".")
        if path and path[0] != group:
            group = path[0]
            lines.append(f"    {'#: ' if parameter.name.startswith(EXPERIMENT) else ''}{group}:")
        indent = "      " if path else "    "
        given = "#: " if parameter.name.startswith(EXPERIMENT) else ""
        lines += [f"{indent}# {parameter.text}", f"{indent}{given}{name}: {parameter.default_text}"]
    return "\n".join(lines) + "\n"


def parameters_markdown() -> str:
    """Return the table for the documentation."""
    lines = ["| name | default | meaning [unit], range |", "| --- | --- | --- |"]
    for parameter in PARAMETERS:
        lines.append(f"| `{parameter.name}` | `{parameter.default_text}` | {parameter.text} |")
    return "\n".join(lines) + "\n"


def _check_device(name: str) -> None:
    """Raise unless a device may have this name; whether this machine has it turns out when the node is configured."""
    if not DEVICE_NAME.fullmatch(name):
        raise InvalidOptionsError(f"device = '{name}' is no name of a device; give cpu, or cuda:0, cuda:1 ...")


def _check(parameters: list[RosParameter]) -> SetParametersResult:
    for parameter in parameters:
        try:
            if parameter.name == "gripper":
                load_gripper(parameter.value)
            elif parameter.name == "device":
                _check_device(parameter.value)
            elif parameter.name == "preset":
                load_preset(parameter.value)
            elif parameter.name == "record.topics":
                logged_topics({parameter.name: parameter.value})
            elif parameter.name.startswith(EXPERIMENT):
                experiment_defaults({parameter.name: parameter.value})
        except DefgraspError as error:
            return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


if __name__ == "__main__":
    print(parameters_markdown() if "--markdown" in sys.argv[1:] else parameters_yaml(), end="")
