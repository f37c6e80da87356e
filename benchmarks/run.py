"""Cost of a time step, stage by stage, over scenes, environments and stiffnesses.

Run: ``python benchmarks/run.py`` (four minutes on two busy cores), or with ``--scene``, ``--environments``,
``--youngs-modulus`` for other combinations; ``--json FILE`` keeps all numbers. It needs Python, Warp, NumPy, SciPy and
this repository; without installing: ``PYTHONPATH=. python benchmarks/run.py``.

Scenes are the objects of ``scenes.py`` and mesh files, squeezed and held for a moment, each environment with another
grasp; ``held``, a block between two pads as in comparisons of simulators; and ``pickup``, the whole pickup experiment.

Every case has a process of its own. A squeeze runs twice: on one core with its stages timed, then on all cores,
untimed. Times of stages are processor times of the thread, so that other work on the machine matters little; on CUDA
they are wall times with a synchronisation around each stage.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import bare_machine  # noqa: F401 (before NumPy)
import numpy as np
import warp as wp
from element_order import BLOCK, SQUARE_PADS
from scenes import HAND, SHAPES, SQUEEZE_TIME, TIME_STEP, Squeeze, grasps_of, mesh_of
from stages import StageTimes, floors, recorded_stages, thread_clock
from threadpoolctl import ThreadpoolController

from defgrasp_ros.evaluation import EvaluationOptions
from defgrasp_ros.experiments.evaluate import evaluate_grasps
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.shapes import box
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.simulation.simulator import Simulator, find_device
from defgrasp_ros.simulation.stepper import StepReport

HELD_STEPS = (0.005, 0.01)
"""Time steps of the held block [s]."""
HELD_FORCE = 2 * 1.749
"""Closing force on the held block [N]."""
HELD_TIME = 1.0
"""Time for which it hangs, at the end of which its creep is measured [s]."""
DEFAULT_SCENES = ("rectangle", "held")


@dataclass(frozen=True)
class Case:
    """What is run."""

    scene: str
    environments: int
    youngs_modulus: float
    """[Pa]"""
    device: str

    @property
    def material(self) -> Material:
        """The standard material of this stiffness."""
        return Material(self.youngs_modulus)


class Meter:
    """Processor and wall time since it was made."""

    def __init__(self, device: wp.Device):
        self._device = device
        self._begin = time.process_time(), time.perf_counter()

    def read(self) -> dict[str, float]:
        """Return both [s]."""
        wp.synchronize_device(self._device)
        cpu, wall = self._begin
        return {"cpu_time": time.process_time() - cpu, "wall_time": time.perf_counter() - wall}


# --- cases ------------------------------------------------------------------------------------------------------


def measure(case: Case) -> list[dict]:
    """Run a case; return its rows of the table. Times in s, memory in bytes."""
    rows = {"held": measure_held, "pickup": measure_pickup}.get(case.scene, measure_squeeze)(case)
    memory = peak_memory(find_device(case.device))
    return [{**asdict(case), **row, "peak_memory": memory} for row in rows]


def measure_squeeze(case: Case) -> list[dict]:
    """Squeeze and short hold, on one core with stages, then on all."""
    device, cores = find_device(case.device), os.sched_getaffinity(0)
    model = ObjectModel(case.scene, mesh_of(case.scene), case.material)
    os.sched_setaffinity(0, {min(cores)})
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        squeeze = Squeeze(model, case.environments, case.device)
        with recorded_stages(thread_clock(device)) as times:
            squeeze.run()
        stages = stage_rows(times, floors(times, model.mesh, device))
    problems, systems = times.problems.total(), times.systems.total()
    contacts = {
        "mean_contact_points": mean(times.problems),
        "systems_per_contact_problem": systems / max(problems, 1),
        "mean_unknowns_of_system": mean(times.systems),
    }
    os.sched_setaffinity(0, cores)
    del squeeze
    meter = Meter(device)
    squeeze = Squeeze(model, case.environments, case.device)
    setup = meter.read()
    meter = Meter(device)
    reports = squeeze.run()
    return [
        {
            **size(model),
            **meter.read(),
            **counts(reports),
            **contacts,
            "time_step": TIME_STEP,
            "simulated_time": TIME_STEP * len(reports),
            "setup_cpu_time": setup["cpu_time"],
            "stages": stages,
        }
    ]


def measure_held(case: Case) -> list[dict]:
    """The block of 350 nodes and 1080 tetrahedra, gripped without gravity, then hanging between two pads."""
    device = find_device(case.device)
    model = ObjectModel("held block", box(BLOCK, (9, 6, 4)), case.material)
    worlds, rows = np.arange(case.environments), []
    force, nowhere = np.full(len(worlds), HELD_FORCE), np.full(len(worlds), -1.0)
    for h in HELD_STEPS:
        simulator = Simulator(model, SQUARE_PADS, case.environments, case.device)
        grasps = [Grasp(grasp.position, [0.0, 0.0, 0.0, 1.0]) for grasp in grasps_of(model.mesh, len(worlds))]
        simulator.place_gripper(worlds, grasps, np.full(len(worlds), BLOCK[1] / 2), force)
        simulator.set_gravity(worlds, np.zeros(3))
        ramp = round(SQUEEZE_TIME / h)
        for count in range(1, ramp + 1):
            simulator.step(worlds, h, count / ramp * force, nowhere, quasi_static=True)
        simulator.set_gravity(worlds, np.array([0.0, 0.0, -9.81]))
        reports, heights = [], []
        meter = Meter(device)
        for _ in range(round(HELD_TIME / h)):
            reports.append(simulator.step(worlds, h, force, nowhere, quasi_static=False))
            heights.append(simulator.positions(worlds)[:, :, 2].mean(axis=1))
        row = {**size(model), **meter.read(), **counts(reports)}
        creep = np.abs(heights[-1] - heights[len(heights) // 2]) / (HELD_TIME / 2)
        creeps = {"median_creep": float(np.median(creep)), "max_creep": float(creep.max())}
        rows.append({**row, "time_step": h, "simulated_time": HELD_TIME, **creeps})
    return rows


def measure_pickup(case: Case) -> list[dict]:
    """The pickup experiment with its 5 s hold: one grasp of the rectangle per environment."""
    model = ObjectModel("rectangle", mesh_of("rectangle"), case.material)
    options = EvaluationOptions()
    grasps = grasps_of(model.mesh, case.environments)
    meter = Meter(find_device(case.device))
    evaluations = evaluate_grasps(model, grasps, HAND, options, case.device)
    times, solvers = meter.read(), [evaluation.solver for evaluation in evaluations]
    steps = sum(solver.steps for solver in solvers)
    return [
        {
            **size(model),
            **times,
            "environment_steps": steps,
            "unsolved": sum(not solver.converged for solver in solvers),
            "cuts": sum(solver.step_cuts for solver in solvers),
            "hard_contact_problems": sum(solver.contact_fallbacks for solver in solvers),
            "mean_iterations": sum(solver.iterations for solver in solvers) / steps,
            "picked_up": sum(evaluation.metrics.pickup_success for evaluation in evaluations),
            "time_step": options.time_step,
            "simulated_time": float(np.mean([evaluation.simulated_time for evaluation in evaluations])),
        }
    ]


def size(model: ObjectModel) -> dict[str, int]:
    """Return nodes and tetrahedra of an object."""
    return {"nodes": len(model.mesh.vertices), "tetrahedra": len(model.mesh.tetrahedra)}


def counts(reports: Sequence[StepReport]) -> dict[str, float]:
    """Return how the steps of all environments went."""
    iterations = np.concatenate([report.iterations for report in reports])
    return {
        "environment_steps": len(iterations),
        "unsolved": sum(int((~report.converged).sum()) for report in reports),
        "cuts": sum(int((report.cuts > 0).sum()) for report in reports),
        "hard_contact_problems": sum(int(report.contact_fallbacks.sum()) for report in reports),
        "mean_iterations": float(iterations.mean()),
        "max_iterations": int(iterations.max()),
    }


def mean(sizes: Counter) -> float:
    """Return the mean of counted sizes."""
    return sum(size * count for size, count in sizes.items()) / max(sizes.total(), 1)


def stage_rows(times: StageTimes, least: dict[str, float]) -> list[dict]:
    """Return the tree of stages; the floor of a stage with several places in it is shared out by time."""
    rows = []
    for depth, name, seconds, calls in times.tree():
        total = times.of(name)
        floor = least[name] * seconds / total if name in least and total > 0.0 else None
        rows.append({"depth": depth, "stage": name, "time": seconds, "calls": calls, "floor": floor})
    return rows


def peak_memory(device: wp.Device) -> int:
    """Return the largest memory of this process, or on CUDA of the device's pool [B]."""
    if device.is_cuda:
        return wp.get_mempool_used_mem_high(device)
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    raise OSError("/proc/self/status has no VmHWM")


# --- output -----------------------------------------------------------------------------------------------------


def print_row(row: dict) -> None:
    """Print what was measured in a case."""
    environments, steps = row["environments"], row["environment_steps"]
    simulated = environments * row["simulated_time"]
    most = f", at most {row['max_iterations']}" if "max_iterations" in row else ""
    print(
        f"\n{row['scene']}: {row['nodes']} nodes, {row['tetrahedra']} tetrahedra, {environments} environments, "
        f"E = {row['youngs_modulus']:g} Pa, steps of {1e3 * row['time_step']:g} ms\n"
        f"  iterations per step {row['mean_iterations']:.2f}{most}; "
        f"unsolved {row['unsolved']}, cut {row['cuts']}, hard contact problems {row['hard_contact_problems']} "
        f"of {steps} steps\n"
        f"  all cores: {row['cpu_time']:.2f} s processor time, {row['wall_time']:.2f} s wall time; "
        f"{1e3 * row['cpu_time'] / steps:.3f} ms per environment step, "
        f"{steps / row['wall_time']:.0f} environment steps per second\n"
        f"  {row['cpu_time'] / simulated:.3f} s processor time per simulated second of an environment, "
        f"{simulated / row['wall_time']:.2f} simulated seconds x environments per second\n"
        f"  peak memory {row['peak_memory'] / 2**20:.0f} MiB"
    )
    if "max_creep" in row:
        median, largest = 1e3 * row["median_creep"], 1e3 * row["max_creep"]
        print(f"  creep in the second half: median {median:.1e} mm/s, largest {largest:.1e} mm/s")
    if "picked_up" in row:
        print(f"  {row['picked_up']} of {environments} picked up; {row['wall_time'] / environments:.2f} s per grasp")
    if "stages" in row:
        print(
            f"  contact problems: {row['mean_contact_points']:.0f} points, "
            f"{row['systems_per_contact_problem']:.1f} linear systems of {row['mean_unknowns_of_system']:.0f} unknowns"
        )
        print_stages(row["stages"], steps)


def print_stages(stages: list[dict], steps: int) -> None:
    """Print the tree of times per environment step on one core."""
    whole = stages[0]["time"]
    print(f"\n  {'one core, per environment step':38} {'[us]':>9} {'share':>7} {'over floor':>11}")
    for stage in stages:
        over = f"{stage['time'] / stage['floor']:10.1f}x" if stage["floor"] else ""
        name = "  " * stage["depth"] + stage["stage"]
        print(f"  {name:38} {1e6 * stage['time'] / steps:9.1f} {stage['time'] / whole:7.1%} {over:>11}")
    floor = floor_of_step(stages)
    solve = sum(stage["time"] for stage in stages if stage["stage"] == "contact solve")
    print(f"  {'step over shared product + element pass, bare':57} {whole / floor:10.1f}x")
    print(f"  {'the same without the contact solve':57} {(whole - solve) / floor:10.1f}x", flush=True)


def floor_of_step(stages: list[dict]) -> float:
    """Return the floors of shared product and element pass together [s]."""
    chosen = ("shared product", "element pass")
    return sum(stage["floor"] for stage in stages if stage["stage"] in chosen and stage["floor"])


def numbers(kind: Callable) -> Callable[[str], list]:
    """Return a parser of numbers separated by commas."""
    return lambda text: [kind(part) for part in text.split(",")]


def main() -> None:
    """Run all cases of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    scenes = ", ".join([*SHAPES, "held", "pickup"])
    parser.add_argument("--scene", nargs="+", default=DEFAULT_SCENES, help=f"{scenes}, or mesh files")
    parser.add_argument("--environments", type=numbers(int), default=[1, 50], help="e.g. 1,50,800")
    parser.add_argument("--youngs-modulus", type=numbers(float), default=[2e5, 2e9], help="[Pa], e.g. 2e4,2e5,2e6,2e9")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    arguments = parser.parse_args()
    machine = {
        "date": time.strftime("%Y-%m-%d"),
        "machine": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "warp": wp.config.version,
        "numpy": np.__version__,
        "device": arguments.device,
    }
    print(", ".join(f"{name} {value}" for name, value in machine.items()))
    rows = []
    for scene, modulus, environments in itertools.product(
        arguments.scene, arguments.youngs_modulus, arguments.environments
    ):
        case = Case(scene, environments, modulus, arguments.device)
        with multiprocessing.get_context("spawn").Pool(1) as process:
            part = process.apply(measure, (case,))
        for row in part:
            print_row(row)
        rows += part
        if arguments.json:
            arguments.json.write_text(json.dumps({"machine": machine, "cases": rows}, indent=1))


if __name__ == "__main__":
    main()
