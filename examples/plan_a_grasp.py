"""Choose the gentlest of several grasps: a planner that asks a running evaluator.

Start the evaluator in one terminal, ``defgrasp_evaluator``, and this in another::

    python examples/plan_a_grasp.py
    python examples/plan_a_grasp.py --mesh banana.stl --grasps banana_grasps.json --youngs-modulus 1e5

Without a mesh it plans for a soft kidney that lies on a platform, with eight grasps from above; one of them misses
the object and one presses too little to carry it. Among the grasps that hold, the one with the smallest peak
von Mises stress wins: it is the least likely to bruise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial.transform import Rotation

from defgrasp_ros.cli import ProgressBar
from defgrasp_ros.client import GraspEvaluatorClient
from defgrasp_ros.errors import DefgraspError
from defgrasp_ros.evaluation import GraspEvaluation, Phase, Progress
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.grasp_files import read_grasps
from defgrasp_ros.gripper import load_gripper
from defgrasp_ros.material import Material
from defgrasp_ros.mesh.mesh_files import read_mesh
from defgrasp_ros.mesh.object_mesh import mesh_from_surface
from defgrasp_ros.mesh.shapes import kidney_surface
from defgrasp_ros.object_model import ObjectModel
from defgrasp_ros.report import evaluation_table, feature_table, material_text

SOFT_TISSUE = Material(youngs_modulus=6e4, poissons_ratio=0.4, density=1050.0, friction_coefficient=0.6)
"""The demonstration's kidney: firmer than a real one, much softer than rubber."""

START_TIMEOUT = 60.0
"""How long to wait for an evaluator that is only just being started [s]."""

EDGE_LENGTH, ELEMENT_ORDER = 0.0085, 1
"""Of the kidney's tetrahedra [m], [-]; fine enough for a ranking, and done in a minute on two cores."""

FIRM = 4.0
"""Target force of the demonstration's grasps [N], twice what the weight alone asks for."""

PLAIN_WIDTH = 150
"""Width of the table where the output is no terminal [characters]."""


def grasp_from_above(
    id: str, x: float, y: float, z: float = 0.019, yaw: float = 0.0, tilt: float = 0.0, force: float | None = FIRM
) -> Grasp:
    """Return a grasp that comes from above and closes along y.

    Args:
        id: Its name.
        x, y, z: Where the middle between the pads goes [m].
        yaw: Turn about the vertical [deg].
        tilt: Turn of the approach about the closing axis [deg].
        force: Sum of both pads' normal forces [N]; None: enough to carry the object.
    """
    rotation = Rotation.from_euler("ZXY", [yaw, 180.0, tilt], degrees=True)
    return Grasp(np.array([x, y, z]), rotation.as_quat(), id=id, target_force=force)


def kidney_grasps() -> list[Grasp]:
    """Return candidates for the kidney of the demonstration, good ones and bad ones."""
    return [
        grasp_from_above("middle", 0.0, 0.004),
        grasp_from_above("thick end", 0.024, -0.003, yaw=-16.0),
        grasp_from_above("thin end", -0.024, -0.003, yaw=16.0),
        grasp_from_above("askew", 0.0, 0.004, yaw=35.0),
        grasp_from_above("tilted", 0.006, 0.004, z=0.021, tilt=20.0),
        grasp_from_above("fingertips", 0.0, 0.004, z=0.026),
        grasp_from_above("too weak", 0.0, 0.004, force=1.0),
        grasp_from_above("beside", 0.0, 0.120),
    ]


def rank(evaluations: Sequence[GraspEvaluation]) -> list[GraspEvaluation]:
    """Return the grasps that hold, the one with the smallest peak stress first."""
    held = [evaluation for evaluation in evaluations if evaluation.metrics.pickup_success]
    return sorted(held, key=lambda evaluation: evaluation.metrics.max_von_mises_stress)


def phase_printer(console: Console) -> Callable[[Progress], None]:
    """Return a callback that writes a line whenever the evaluator begins a phase."""
    seen: set[Phase] = set()

    def show(progress: Progress) -> None:
        if progress.phase not in seen:
            seen.add(progress.phase)
            phase = progress.phase.name.lower().replace("_", " ")
            console.print(f"{phase}: {progress.active_grasps} of {progress.grasp_count} grasps running")

    return show


def plan(model: ObjectModel, grasps: Sequence[Grasp], picture: Path | None, console: Console) -> GraspEvaluation | None:
    """Ask the evaluator, show its answer, and return the best grasp, if one holds."""
    console.print(f"{model.name}: {len(model.mesh.tetrahedra)} tetrahedra, {1e3 * model.mass:.0f} g")
    console.print(material_text(model.material))
    with GraspEvaluatorClient() as client, ProgressBar(console, len(grasps)) as bar:
        client.wait_until_ready(START_TIMEOUT)
        answer = client.evaluate_grasps(
            model.mesh,
            model.material,
            grasps,
            object_name=model.name,
            return_fields=picture is not None,
            on_progress=bar.on_progress if console.is_terminal else phase_printer(console),
        )
    ranking = rank(answer.evaluations)
    failed = [evaluation for evaluation in answer.evaluations if not evaluation.metrics.pickup_success]
    console.print(feature_table([*ranking, *failed]), evaluation_table([*ranking, *failed]), sep="\n")
    for evaluation in failed:
        console.print(f"{evaluation.grasp_id}: {evaluation.message}", markup=False, highlight=False)
    if picture:
        from defgrasp_ros.drawing.evaluated_grasps import draw_evaluations

        picture.parent.mkdir(parents=True, exist_ok=True)
        draw_evaluations(picture, model, load_gripper(), grasps, answer.evaluations)
        console.print(f"picture: {picture.absolute()}", soft_wrap=True)
    console.print(f"log: {answer.log_path}" if answer.log_path else answer.message, markup=False, soft_wrap=True)
    return ranking[0] if ranking else None


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Ask a running evaluator for the gentlest of several grasps.")
    parser.add_argument("--mesh", type=Path, help="mesh file of the object [m]; default: a soft kidney made here")
    parser.add_argument("--grasps", type=Path, help="candidate grasps for --mesh: .json, or .h5 of DefGraspSim")
    parser.add_argument("--youngs-modulus", type=float, default=SOFT_TISSUE.youngs_modulus, metavar="PA")
    parser.add_argument("--poissons-ratio", type=float, default=SOFT_TISSUE.poissons_ratio, metavar="X")
    parser.add_argument("--density", type=float, default=SOFT_TISSUE.density, metavar="KG/M3")
    parser.add_argument("--friction", type=float, default=SOFT_TISSUE.friction_coefficient, metavar="X")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the deformed object and its stress")
    arguments = parser.parse_args()
    if (arguments.mesh is None) != (arguments.grasps is None):
        parser.error("--mesh and --grasps belong together")
    return arguments


def main() -> int:
    """Plan, and say which grasp to take; 1 if none holds or the evaluator refuses."""
    arguments = parse_arguments()
    console = Console() if sys.stdout.isatty() else Console(width=PLAIN_WIDTH)
    try:
        material = Material(arguments.youngs_modulus, arguments.poissons_ratio, arguments.density, arguments.friction)
        if arguments.mesh:
            model = ObjectModel(arguments.mesh.stem, read_mesh(arguments.mesh), material)
            grasps = read_grasps(arguments.grasps)
        else:
            mesh = mesh_from_surface(*kidney_surface(), target_edge_length=EDGE_LENGTH, element_order=ELEMENT_ORDER)
            model = ObjectModel("kidney", mesh, material)
            grasps = kidney_grasps()
        best = plan(model, grasps, arguments.picture, console)
    except DefgraspError as error:
        console.print(f"{error.code.name}: {error}", markup=False)
        return 1
    if best is None:
        console.print("No grasp holds the object.")
        return 1
    stress = 1e-3 * best.metrics.max_von_mises_stress
    console.print(f"Take '{best.grasp_id}': it holds with the smallest peak stress, {stress:.3g} kPa.", markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
