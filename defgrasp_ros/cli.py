"""The ``defgrasp`` command: objects, grasps and their evaluation without ROS, logs, and validation."""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from defgrasp_ros.commands.evaluation_options import Experiments, Preset, evaluation_options, with_constants
from defgrasp_ros.commands.export import export
from defgrasp_ros.commands.grippers import grippers
from defgrasp_ros.commands.info import info
from defgrasp_ros.commands.mesh import mesh
from defgrasp_ros.commands.object_argument import (
    EdgeLength,
    EdgeRadius,
    ElementOrder,
    ObjectArgument,
    Scale,
    WallThickness,
    prepared_object,
)
from defgrasp_ros.commands.objects import objects
from defgrasp_ros.commands.progress import ProgressBar, progress_line
from defgrasp_ros.commands.replay import replay
from defgrasp_ros.commands.report import report
from defgrasp_ros.commands.rerun import rerun
from defgrasp_ros.commands.sample import sample
from defgrasp_ros.errors import DefgraspError, InvalidGraspError
from defgrasp_ros.gripper import DEFAULT_GRIPPER, load_gripper
from defgrasp_ros.material_library import find_material
from defgrasp_ros.object_model import ObjectModel

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # brackets in the help are units
)
app.command()(export)
app.command()(grippers)
app.command()(info)
app.command()(mesh)
app.command()(objects)
app.command()(replay)
app.command()(report)
app.command()(rerun)
app.command()(sample)


@app.callback()
def _defgrasp() -> None:
    """Simulate how grasps of a deformable object turn out, and show how right that is."""


@app.command(epilog="Example: defgrasp evaluate banana --grasps grasps.json --experiments all --output results")
@with_constants
def evaluate(
    object: ObjectArgument,
    grasps: Annotated[Path, typer.Option(help="Grasp poses: .json in our frame, or .h5 of DefGraspSim")],
    material: Annotated[
        str | None, typer.Option(help="Material of `defgrasp objects --materials`; default: the object's own")
    ] = None,
    youngs_modulus: Annotated[
        float | None, typer.Option(help="Young's modulus [Pa], in place of the material's")
    ] = None,
    poissons_ratio: Annotated[float | None, typer.Option(help="Poisson's ratio [-]")] = None,
    density: Annotated[float | None, typer.Option(help="Density [kg/m^3]")] = None,
    friction: Annotated[float | None, typer.Option(help="Coulomb friction coefficient [-]")] = None,
    grasp_indices: Annotated[str | None, typer.Option(help="Rows of the grasp file to evaluate, as 0,3,7")] = None,
    scale: Scale = 1.0,
    edge_length: EdgeLength = None,
    wall_thickness: WallThickness = None,
    edge_radius: EdgeRadius = None,
    element_order: ElementOrder = None,
    gripper: Annotated[str, typer.Option(help="Gripper description in config/grippers")] = DEFAULT_GRIPPER,
    experiments: Experiments = None,
    preset: Preset = None,
    time_limit: Annotated[
        float | None,
        typer.Option(help="Wall time after which the run ends with what is finished [s]", show_default="none"),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda:0")] = "cpu",
    output: Annotated[Path | None, typer.Option(help="Folder for evaluations.json and evaluations.png")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on standard output, and nothing else")
    ] = False,
    **constants: float | int | bool | None,
) -> None:
    """Try every grasp of OBJECT in the experiments; report features, metrics and why a grasp failed."""
    from defgrasp_ros.experiments import evaluate_grasps
    from defgrasp_ros.grasp_files import read_grasps
    from defgrasp_ros.report import document, evaluation_table, feature_table, material_text, reasons
    from defgrasp_ros.stop_signal import StopSignal

    console = Console(stderr=True)
    values = {
        "youngs_modulus": youngs_modulus,
        "poissons_ratio": poissons_ratio,
        "density": density,
        "friction_coefficient": friction,
    }
    given = {name: value for name, value in values.items() if value is not None}
    options = evaluation_options(preset, experiments=experiments, **constants)
    options = replace(options, return_fields=options.return_fields or output is not None)
    hand = load_gripper(gripper)
    indices, chosen = _chosen(read_grasps(grasps), grasp_indices)
    name, prepared, own = prepared_object(object, scale, edge_length, wall_thickness, edge_radius, element_order)
    substance = replace(find_material(material).material if material else own, **given)
    model = ObjectModel(name, prepared.logged(), substance)
    console.print(
        f"{model.name}: {len(model.mesh.vertices)} nodes, {len(model.mesh.tetrahedra)} tetrahedra of order "
        f"{model.mesh.element_order}, {1e3 * model.mass:.1f} g"
    )
    console.print(material_text(substance))
    stop = StopSignal()
    if time_limit is not None:
        stop.limit(time_limit)
    with ProgressBar(console, len(chosen)) as bar:
        evaluations = evaluate_grasps(model, chosen, hand, options, device, bar, stop)
    for index, evaluation in zip(indices, evaluations, strict=True):
        evaluation.grasp_index = index

    result = document(model, options, device, evaluations)
    if output is not None:
        _write(output, result, model, hand, chosen, evaluations, console)
    if as_json:
        json.dump(result, sys.stdout, allow_nan=False)
        sys.stdout.write("\n")
        return
    screen = _screen()
    screen.print(feature_table(evaluations), evaluation_table(evaluations), sep="\n")
    for line in (f"{evaluation.grasp_id}: {reason}" for evaluation in evaluations for reason in reasons(evaluation)):
        screen.print(line, markup=False, highlight=False)
    counts = Counter(evaluation.code.name for evaluation in evaluations)
    screen.print(", ".join(f"{count} {name}" for name, count in counts.most_common()))


@app.command()
def validate(
    quick: Annotated[bool, typer.Option("--quick", help="Only the cases that take a minute together")] = False,
    device: Annotated[str, typer.Option(help="cpu or cuda:0")] = "cpu",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document on standard output, and nothing else")
    ] = False,
) -> None:
    """Measure what has a known answer, and compare; exit status 1 if a case is beyond its tolerance."""
    import warp as wp

    from defgrasp_ros.simulation.simulator import find_device
    from defgrasp_ros.validation.report import case_document, case_table
    from defgrasp_ros.validation.suite import experiments, run

    console = Console(stderr=True)
    find_device(device)
    cuda = wp.is_cuda_available()
    if not cuda:
        console.print("no CUDA device: CPU and CUDA are not compared", highlight=False)
    chosen, cases = experiments(quick=quick, cuda=cuda), []
    with progress_line(console) as progress:
        task = progress.add_task(chosen[0].name, total=len(chosen))
        for count, (_, measured) in enumerate(run(chosen, device), start=1):
            cases += measured
            following = chosen[count].name if count < len(chosen) else "done"
            progress.update(task, completed=count, description=following)
    failed = sum(not case.passed for case in cases)
    if as_json:
        json.dump(case_document(cases), sys.stdout, allow_nan=False)
        sys.stdout.write("\n")
    else:
        screen = _screen()
        screen.print(case_table(cases))
        screen.print(f"{len(cases)} cases, {failed} failed")
    if failed:
        raise typer.Exit(1)


def _chosen(grasps: list, indices: str | None) -> tuple[list[int], list]:
    """The grasps of the given rows, and the rows."""
    if indices is None:
        return list(range(len(grasps))), grasps
    try:
        rows = [int(text) for text in indices.split(",")]
    except ValueError:
        raise InvalidGraspError(f"--grasp-indices = '{indices}' is not a list of row numbers such as 0,3,7") from None
    wrong = [row for row in rows if not 0 <= row < len(grasps)]
    if wrong:
        raise InvalidGraspError(
            f"--grasp-indices: row {wrong[0]} does not exist; the file has rows 0 to {len(grasps) - 1}"
        )
    return rows, [grasps[row] for row in rows]


def _write(
    output: Path, result: dict, model: ObjectModel, hand, grasps: list, evaluations: list, console: Console
) -> None:
    from defgrasp_ros.drawing.evaluated_grasps import draw_evaluations

    output.mkdir(parents=True, exist_ok=True)
    (output / "evaluations.json").write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    draw_evaluations(output / "evaluations.png", model, hand, grasps, evaluations)
    console.print(f"wrote {output / 'evaluations.json'} and {output / 'evaluations.png'}")


def _screen() -> Console:
    """Standard output; wide where it is no terminal."""
    return Console(width=None if sys.stdout.isatty() else 200)


def main() -> None:
    """Run the command; what the user can mend ends with one line, not with a traceback."""
    try:
        app()
    except DefgraspError as error:
        text = escape(f"{error.code.name}: {error}")
        Console(stderr=True).print("[red]error[/]", text, highlight=False, soft_wrap=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
