"""All experiments, and how a set of them is run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from defgrasp_ros.validation import (
    bending,
    complementarity,
    elasticity,
    energy,
    free_motion,
    friction,
    indentation,
    pickup,
    repeatability,
    thick_tube,
    tipping,
    vibration,
)
from defgrasp_ros.validation.case import Case, Experiment, failure

FAMILIES = (
    elasticity,
    thick_tube,
    bending,
    vibration,
    free_motion,
    energy,
    indentation,
    friction,
    tipping,
    complementarity,
    pickup,
    repeatability,
)
"""Modules with experiments, in the order of the table."""


def experiments(*, quick: bool, cuda: bool) -> list[Experiment]:
    """Return the experiments of a set.

    Args:
        quick: Whether the long ones are left out.
        cuda: Whether the machine has a CUDA device; without one, what compares devices is left out.
    """
    every = (experiment for family in FAMILIES for experiment in family.EXPERIMENTS)
    return [e for e in every if (e.quick or not quick) and (cuda or not e.compares_devices)]


def run(some: Iterable[Experiment], device: str) -> Iterator[tuple[Experiment, list[Case]]]:
    """Run experiments one after the other; one that raises counts as a failed case, and the next follows."""
    for experiment in some:
        yield experiment, measure(experiment, device)


def measure(experiment: Experiment, device: str) -> list[Case]:
    """Run one experiment; what it measured before it raised is kept."""
    cases: list[Case] = []
    try:
        for case in experiment.measure(device):
            cases.append(case)
    except Exception as error:  # whatever it is, the table must show it
        cases.append(failure(experiment.name, f"{type(error).__name__}: {error}"))
    return cases
