"""Presets: named sets of options, as files of ``config/presets`` or of the user."""

from __future__ import annotations

from pathlib import Path

import yaml

from defgrasp_ros.configuration import config_file
from defgrasp_ros.errors import InvalidOptionsError, NotFoundError
from defgrasp_ros.evaluation import EvaluationOptions

SUFFIXES = (".yaml", ".yml")


def load_preset(preset: str | Path) -> EvaluationOptions:
    """Return the options of a preset; those it does not name have their defaults.

    Args:
        preset: Name of a file in ``config/presets`` without its suffix, or path of a YAML file.

    Raises:
        NotFoundError: If there is no such preset.
        InvalidOptionsError: If the file cannot be read, names an unknown option, or a value is outside its range.
    """
    path = _file_of(preset)
    try:
        values = yaml.safe_load(path.read_text()) or {}
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InvalidOptionsError(f"preset {path} is not YAML: {error}") from None
    if not isinstance(values, dict):
        raise InvalidOptionsError(f"preset {path} holds a {type(values).__name__}; give lines of option: value")
    known = EvaluationOptions.__dataclass_fields__
    unknown = [name for name in values if name not in known]
    if unknown:
        raise InvalidOptionsError(f"preset {path}: option '{unknown[0]}' is unknown; known are {', '.join(known)}")
    try:
        return EvaluationOptions(**values)
    except InvalidOptionsError as error:
        raise InvalidOptionsError(f"preset {path}: {error}") from None


def preset_names() -> list[str]:
    """Return the names of the presets in ``config/presets``."""
    return sorted(file.stem for file in config_file("presets/paper.yaml").parent.glob("*.yaml"))


def _file_of(preset: str | Path) -> Path:
    path = Path(preset)
    if path.suffix in SUFFIXES:
        if not path.is_file():
            raise NotFoundError(f"preset file '{preset}' does not exist")
        return path
    if preset not in preset_names():
        known = ", ".join(preset_names())
        raise NotFoundError(f"preset '{preset}' is unknown; known are {known}; or give a .yaml file")
    return config_file(f"presets/{preset}.yaml")
