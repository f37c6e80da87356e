"""Charts of a report as SVG whose ink takes the colours of the page, light or dark."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from defgrasp_ros.analysis.recorded_run import TimeSeries
from defgrasp_ros.evaluation import AccelerationResult, SqueezeResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

INK = {
    "#010101": "var(--ink)",
    "#020202": "var(--muted)",
    "#030303": "var(--line)",
    "#040404": "var(--left)",
    "#050505": "var(--right)",
    "#060606": "var(--platform)",
    "#070707": "var(--accent)",
}
"""Colours in which the charts are drawn, and the colours of the page that take their place."""
TEXT, MUTED, LINE, LEFT, RIGHT, PLATFORM, ACCENT = INK
SIZE, DPI = 8.5, 72
"""Of the letters [point]; and of the drawing, so that a point is a pixel."""
WIDTH, PANEL_HEIGHT = 7.2, 1.35
"""Of a chart over time and of each of its panels [inch]."""

LINE_WIDTH, WIDE_LINE = 1.4, 3.6
"""Of a curve, and of the left finger's, which still shows where the right finger's lies upon it [point]."""

PANELS = (
    ("force [N]", 1.0, {"left_normal_force": LEFT, "right_normal_force": RIGHT, "platform_force": PLATFORM}),
    ("opening [mm]", 1e3, {"opening": ACCENT}),
    ("slip [mm]", 1e3, {"slip": ACCENT}),
    ("peak stress [kPa]", 1e-3, {"max_von_mises_stress": ACCENT}),
)
"""Panels of the chart over time: label, factor and curves with their colours."""


def course_chart(series: TimeSeries) -> Markup | None:
    """Return forces, opening, slip and stress over time, one panel each; None if there is nothing to draw."""
    panels = [panel for panel in PANELS if any(series.has(name) for name in panel[2])]
    if not panels or len(series.time) < 2:
        return None
    figure, axes = _figure(WIDTH, PANEL_HEIGHT * len(panels) + 0.3, len(panels))
    for ax, (label, factor, curves) in zip(axes, panels, strict=True):
        for name, color in curves.items():
            if series.has(name):
                width = WIDE_LINE if color == LEFT else LINE_WIDTH
                ax.plot(series.time, factor * series.values[name], color=color, linewidth=width)
        ax.set_ylabel(label)
        ax.margins(x=0.0)
    axes[-1].set_xlabel("simulated time [s]")
    return _svg(figure)


def direction_chart(result: AccelerationResult, scale: ScalarMappable, unit: str) -> Markup:
    """Return a bar per direction up to the acceleration at loss, with a mark where gross slip began.

    A bar with an arrow is a lower bound, a cross a direction without a number.
    """
    figure, (ax,) = _figure(WIDTH, 1.9, 1)
    numbers = np.arange(len(result.at_loss))
    known = np.isfinite(result.at_loss)
    top = float(np.nanmax(result.at_loss, initial=0.0))
    colors = scale.to_rgba(result.at_loss[known])
    ax.bar(numbers[known], result.at_loss[known], width=0.62, color=colors, linewidth=0)
    bounds = known & result.is_lower_bound
    ax.plot(numbers[bounds], result.at_loss[bounds] + 0.045 * top, "^", color=TEXT, markersize=4.5, clip_on=False)
    ax.plot(numbers[~known], np.full(int((~known).sum()), 0.04 * top), "x", color=MUTED, markersize=5)
    ax.hlines(result.at_slip, numbers - 0.42, numbers + 0.42, color=TEXT, linewidth=1.4)
    ax.set_xticks(numbers)
    ax.set_xlim(-0.6, len(numbers) - 0.4)
    ax.set_ylim(0.0, 1.12 * top or 1.0)
    ax.set_xlabel("direction")
    ax.set_ylabel(f"[{unit}]")
    return _svg(figure)


def squeeze_chart(result: SqueezeResult) -> Markup | None:
    """Return deformation and peak stress over the closing force; None if no force was reached."""
    if not np.isfinite(result.max_deformation).any():
        return None
    figure, axes = _figure(WIDTH, 2 * PANEL_HEIGHT + 0.3, 2)
    curves = (
        ("deformation [mm]", 1e3 * result.max_deformation),
        ("peak stress [kPa]", 1e-3 * result.max_von_mises_stress),
    )
    for ax, (label, values) in zip(axes, curves, strict=True):
        ax.plot(result.force, values, "o-", color=ACCENT, linewidth=1.4, markersize=3)
        ax.set_ylabel(label)
        ax.set_ylim(bottom=0.0)
    axes[-1].set_xlabel("force, sum of both pads [N]")
    return _svg(figure)


def _figure(width: float, height: float, panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels one above the other with one horizontal axis."""
    import matplotlib.figure
    from matplotlib.ticker import MaxNLocator

    figure = matplotlib.figure.Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    axes = list(figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0])
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
        ax.spines[["left", "bottom"]].set_color(LINE)
        ax.tick_params(colors=MUTED, labelsize=SIZE, length=3, color=LINE)
        ax.grid(axis="y", color=LINE, linewidth=0.6)
        ax.set_axisbelow(True)
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.xaxis.label.set(color=MUTED, fontsize=SIZE)
        ax.yaxis.label.set(color=MUTED, fontsize=SIZE)
    figure.align_ylabels(axes)
    return figure, axes


def _svg(figure: Figure) -> Markup:
    """Return a figure as an SVG element without anything that is not needed, with letters as text."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "defgrasp"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<g id=\"[^\"]*\"", "<g", text)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    text = re.sub(r" xmlns(:\w+)?=\"[^\"]*\"", "", text).replace("xlink:href", "href")
    text = re.sub(r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>", r"<svg class='chart' \1>", text, count=1)
    for color, variable in INK.items():
        text = text.replace(color, variable)
    return Markup(re.sub(r"\n\s*", "\n", text))
