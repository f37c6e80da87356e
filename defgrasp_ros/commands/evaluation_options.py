"""The options of an evaluation on the command line: one for each constant of the protocol, and presets of them."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from defgrasp_ros.evaluation import ALL_EXPERIMENTS, EvaluationOptions, Experiment
from defgrasp_ros.option import Option, options_of
from defgrasp_ros.presets import load_preset, preset_names

Experiments = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help=f"What is done, with commas: {', '.join(Experiment)}; or {ALL_EXPERIMENTS}. The pickup is always done",
    ),
]
Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help=f"Options from config/presets ({', '.join(preset_names())}) or from a .yaml file; those given here win",
    ),
]


def with_constants(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command an option for each constant of the protocol; it gets them in its ``**constants``.

    One that is not given on the command line is None.
    """
    signature = inspect.signature(command, eval_str=True)
    own = [parameter for parameter in signature.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
    constants = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[option.kind | None, typer.Option(help=_help(option), show_default=False)],
        )
        for name, option in options_of(EvaluationOptions).items()
    ]
    command.__signature__ = signature.replace(parameters=[*own, *constants])
    return command


def evaluation_options(preset: str | None, **given: Any) -> EvaluationOptions:
    """Return the options of a preset, with those given in place of its own; None: not given.

    Raises:
        NotFoundError: If there is no such preset.
        InvalidOptionsError: If a value is outside its range, or an experiment is unknown.
    """
    base = load_preset(preset) if preset else EvaluationOptions()
    return dataclasses.replace(base, **{name: value for name, value in given.items() if value is not None})


def _help(option: Option) -> str:
    return f"{option.text}  [default: {option.default_text}]"
