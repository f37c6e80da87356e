"""The report of a run: one HTML page that needs nothing else, with tables, pictures and charts."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from defgrasp_ros.analysis.recorded_run import RecordedGrasp, RecordedRun
from defgrasp_ros.analysis.report_numbers import TABLE_TITLES, meaning_of, metric_columns, shown_unit, table_rows
from defgrasp_ros.analysis.report_sections import Sections
from defgrasp_ros.errors import InvalidOptionsError, RecordingError
from defgrasp_ros.evaluation import EvaluationOptions, in_order
from defgrasp_ros.option import options_of
from defgrasp_ros.recording.topic import NANOSECONDS

TEMPLATE = "report.html"
BEST, FAILED = 3, 2
"""Grasps that are shown in detail where there are many: the best ones, the worst that holds, and of the failed ones
those that failed in different ways."""
SHOW_ALL = 6
"""Runs of so many grasps are shown in detail as a whole."""


def write_report(path: Path, run: RecordedRun, grasps: str | None = None) -> None:
    """Write the page of a run.

    Args:
        path: The file.
        run: The run.
        grasps: Which grasps are shown in detail: numbers or ids with commas between them, or ``"all"``; None: all of
            a few, of many the best, the worst and some that failed.

    Raises:
        InvalidOptionsError: If there is no such grasp.
        RecordingError: If the file cannot be written.
    """
    page = render(run, chosen_grasps(run, grasps))
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def render(run: RecordedRun, shown: Sequence[RecordedGrasp]) -> str:
    """Return the page of a run as text, with the grasps of ``shown`` in detail."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("defgrasp_ros.analysis", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    columns = metric_columns(run)
    return environment.get_template(TEMPLATE).render(
        run=run,
        facts=_facts(run),
        options=_option_rows(run),
        columns=[
            {"title": TABLE_TITLES[name], "unit": shown_unit(unit), "meaning": meaning_of("GraspMetrics", name)}
            for name, _, _, unit, _ in columns
        ],
        rows=table_rows(run, columns),
        shown={grasp.index for grasp in shown},
        sections=Sections(run, shown).sections(),
    )


def chosen_grasps(run: RecordedRun, text: str | None) -> list[RecordedGrasp]:
    """Return the grasps that are shown in detail; arguments and errors as ``write_report``."""
    if text == "all":
        return list(run.grasps)
    if text is None:
        return _remarkable(run)
    by_name = {str(grasp.index): grasp for grasp in run.grasps} | {grasp.id: grasp for grasp in run.grasps}
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in by_name:
            known = ", ".join(grasp.id for grasp in run.grasps[:20])
            raise InvalidOptionsError(
                f"--grasps: there is no grasp '{name}'; the log has numbers 0 to {len(run.grasps) - 1}: {known}"
            )
    return [by_name[name] for name in dict.fromkeys(names)]


def _remarkable(run: RecordedRun) -> list[RecordedGrasp]:
    """Return the best grasps, the worst that holds and some that failed, each in its own way."""
    ranking = sorted(run.held, key=lambda grasp: grasp.evaluation.metrics.max_von_mises_stress)
    failed = [grasp for grasp in run.grasps if not grasp.evaluation.metrics.pickup_success]
    if len(run.grasps) <= SHOW_ALL:
        return [*ranking, *failed]
    kinds = {grasp.evaluation.code: grasp for grasp in reversed(failed)}
    return [*ranking[:BEST], *ranking[BEST:][-1:], *list(kinds.values())[:FAILED]]


def _facts(run: RecordedRun) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return what is known of the run as groups of labels and texts."""
    material, model = run.material, run.model
    groups = [
        (
            "Object",
            [("name", run.object_name)]
            + (
                [
                    ("size", " × ".join(f"{1e3 * side:.3g}" for side in model.mesh.extents) + " mm"),
                    ("mass", f"{1e3 * model.mass:.4g} g"),
                    ("mesh", f"{len(model.mesh.vertices)} nodes, {len(model.mesh.tetrahedra)} tetrahedra"),
                    ("element order", str(model.mesh.element_order)),
                ]
                if model
                else [("mesh", "not in the log")]
            ),
        ),
        (
            "Material",
            [
                ("Young's modulus", _engineering(material.youngs_modulus, "Pa")),
                ("Poisson's ratio", f"{material.poissons_ratio:g}"),
                ("density", f"{material.density:g} kg/m³"),
                ("friction coefficient", f"{material.friction_coefficient:g}"),
            ],
        ),
        (
            "Run",
            [
                ("gripper", run.gripper.name),
                ("experiments", ", ".join(name.replace("_", " ") for name in in_order(run.options.experiments))),
                ("device", run.provenance.get("device", "unknown")),
                ("start", f"{datetime.fromtimestamp(run.start_time / NANOSECONDS).astimezone():%Y-%m-%d %H:%M:%S %Z}"),
                ("wall time", f"{run.wall_time:.1f} s"),
                ("versions", ", ".join(f"{name} {text}" for name, text in run.versions.items()) or "unknown"),
            ],
        ),
    ]
    return groups


def _option_rows(run: RecordedRun) -> list[tuple[str, str, str]]:
    """Return name, value with unit and meaning of every constant of the protocol that was in force."""
    rows = []
    for name, option in options_of(EvaluationOptions).items():
        value = getattr(run.options, name)
        text = ("yes" if value else "no") if isinstance(value, bool) else f"{value:g} {shown_unit(option.unit)}"
        rows.append((name, text.strip(), option.meaning))
    return rows


def _engineering(value: float, unit: str) -> str:
    from matplotlib.ticker import EngFormatter

    return EngFormatter(unit)(value)
