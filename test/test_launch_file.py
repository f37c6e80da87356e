"""The launch file, with stand-ins for the launch packages, which are no wheels."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from unittest.mock import MagicMock

import pytest

LAUNCH_FILE = Path(__file__).resolve().parents[1] / "launch" / "evaluator.launch.py"
MODULES = (
    "launch",
    "launch.actions",
    "launch.substitutions",
    "launch_ros",
    "launch_ros.actions",
    "launch_ros.parameter_descriptions",
    "launch_ros.substitutions",
)


@pytest.fixture
def launch(monkeypatch: pytest.MonkeyPatch) -> dict[str, MagicMock]:
    """Modules whose classes note how they are called."""
    modules = {name: MagicMock(spec=ModuleType) for name in MODULES}
    for name, names in {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument",),
        "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
        "launch_ros.actions": ("LifecycleNode",),
        "launch_ros.parameter_descriptions": ("ParameterValue",),
        "launch_ros.substitutions": ("FindPackageShare",),
    }.items():
        for each in names:
            setattr(modules[name], each, MagicMock(name=each))
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return modules


def test_launch_file_declares_what_it_uses(launch: dict[str, MagicMock]) -> None:
    """It compiles and runs, and every argument that it reads is declared with a description."""
    scope: dict = {}
    exec(compile(LAUNCH_FILE.read_text(), LAUNCH_FILE, "exec"), scope)
    assert scope["generate_launch_description"]() is launch["launch"].LaunchDescription.return_value
    declared = launch["launch.actions"].DeclareLaunchArgument.call_args_list
    assert all(call.kwargs["description"] for call in declared)
    names = {call.args[0] for call in declared}
    assert names == {"params_file", "namespace", "log_level", "autostart"}
    used = {call.args[0] for call in launch["launch.substitutions"].LaunchConfiguration.call_args_list}
    assert used == names
    (node,) = launch["launch_ros.actions"].LifecycleNode.call_args_list
    assert node.kwargs["executable"] == "defgrasp_evaluator"
