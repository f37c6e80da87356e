"""The report of a run: one page that needs nothing else and shows every grasp."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("defgrasp_interfaces.msg", reason="the message definitions are not built")
pytest.importorskip("sensor_msgs.msg")

from recorded_example import GRASPS, write_log  # noqa: E402

from defgrasp_ros.analysis import load_run  # noqa: E402
from defgrasp_ros.analysis.report_page import chosen_grasps, render, write_report  # noqa: E402
from defgrasp_ros.analysis.report_sections import color_bar  # noqa: E402
from defgrasp_ros.drawing.color_scales import stress_scale  # noqa: E402
from defgrasp_ros.drawing.rendering import Camera, compose, compose_transparent, solid  # noqa: E402
from defgrasp_ros.errors import InvalidOptionsError, RecordingError  # noqa: E402

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """What a test wants to know of a page; fails where tags are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        attributes = dict(attrs)
        self.ids += filter(None, [attributes.get("id")])
        self.addresses += filter(None, [attributes.get(name) for name in ("href", "src", "xlink:href")])
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return load_run(write_log(tmp_path_factory.mktemp("logs")))


@pytest.fixture(scope="module")
def text(run) -> str:
    return render(run, run.grasps)


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def ranking(page: Page) -> list[list[str]]:
    """The rows of the table of grasps, without its head."""
    head = next(number for number, row in enumerate(page.rows) if row[:2] == ["#", "grasp"])
    return page.rows[head + 1 : head + 1 + len(GRASPS)]


def test_page_needs_nothing_else(text, page):
    """Pictures are inside; there is no address but data and places of the page itself, and no request by style."""
    assert page.addresses and all(address.startswith(("data:", "#")) for address in page.addresses)
    targets = {address[1:] for address in page.addresses if address.startswith("#")}
    assert targets <= set(page.ids)
    assert not re.search(r"@import|url\((?!#)|https?://", text)
    assert len(text) < 1_000_000


def test_every_grasp_has_its_row(page):
    """The one that holds comes first; the others have their outcome, its reason, and no made-up number."""
    held, dropped, missed = ranking(page)
    assert [held[1], dropped[1], missed[1]] == [grasp.id for grasp in GRASPS]
    assert "held" in held[2] and held[4].strip() == "2.00"
    assert held[-2].startswith("≥ ") and held[-1] == "not measured"
    assert "dropped" in dropped[2] and "it slipped out" in dropped[2]
    assert "no contact" in missed[2] and set(missed[4:]) == {"not measured"}


def test_numbers_have_unit_meaning_and_reason(text, page):
    """A number stands beside its unit and what it means; a missing one beside the reason."""
    deformation = next(row for row in page.rows if row[:2] == ["deformation", "1.00 mm"])
    assert "rigid motion removed" in deformation[2]
    assert "1 of 16 directions have no number; the first: no solution" in text
    assert "Ended early: at 2.5 N: the object slipped out" in text


def test_pictures_and_charts_are_there(page, text):
    """Stress, deformation, both stabilities, a turned state, and charts; a missed grasp says why it has none."""
    assert page.tags.count("image") == 5
    assert len(re.findall("<svg class='chart'", text)) == 4
    assert len(re.findall("<svg class='view'", text)) == 5
    assert "No pictures" in text
    assert "In 2 of 16 directions contact was kept" in text


def test_names_are_escaped(text):
    """What users call things is text, not markup."""
    assert "centre <b>" not in text and "centre &lt;b&gt;" in text and "block &amp; co" in text


def test_reason_for_no_picture_keeps_its_units(run):
    """The sentence begins with a capital letter, and newtons stay N."""
    before = {"pre_contact": run.grasps[0].evaluation.fields["pre_contact"]}
    weak = replace(run.grasps[2].evaluation, message="the pads reached 1 N", fields=before)
    grasp = replace(run.grasps[2], evaluation=weak)
    assert "The pads reached 1 N." in render(replace(run, grasps=[grasp]), [grasp])


def test_choice_of_grasps(run):
    """Numbers, ids, all; a grasp that is not there is an error that names those that are."""
    assert [grasp.index for grasp in chosen_grasps(run, "high,0,high")] == [1, 0]
    assert [grasp.index for grasp in chosen_grasps(run, "all")] == [0, 1, 2]
    assert [grasp.index for grasp in chosen_grasps(run, None)] == [0, 1, 2]
    with pytest.raises(InvalidOptionsError, match="no grasp '7'.*beside"):
        chosen_grasps(run, "0,7")


def test_cut_log_without_mesh_has_a_page(tmp_path):
    """What is missing is said at the top; the rest is there."""
    run = load_run(write_log(tmp_path, with_mesh=False, finished=1, close=False))
    write_report(tmp_path / "report.html", run)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    Page(text)
    assert "The log was not closed" in text and "does not hold the object" in text
    assert text.count("the log ends before its result") >= 2
    with pytest.raises(RecordingError, match="cannot write"):
        write_report(Path(tmp_path / "gone" / "report.html"), run)


def test_log_without_fields_says_so(tmp_path):
    """Logs of older evaluators have numbers and charts, and the page tells why there are no pictures."""
    run = load_run(write_log(tmp_path, with_fields=False))
    text = render(run, run.grasps)
    page = Page(text)
    assert "The log holds no fields over the mesh: no grasp was tried, or an older evaluator" in text
    assert "No pictures: the log holds no fields over the mesh for this grasp" in text
    assert "image" not in page.tags
    assert ranking(page)[0][4].strip() == "2.00"


def test_color_bar_has_unit_and_ends():
    """The scale begins at 0, ends at the largest value, and its labels do not touch."""
    bar = color_bar("stress", stress_scale([np.linspace(0.0, 4300.0, 50)]), 1e-3, "kPa")
    places = [place for place, _ in bar.ticks]
    assert bar.ticks[0] == (0.0, "0") and bar.ticks[-1][1] == "4.3" and places[-1] == 100.0
    assert min(np.diff(places)) > 5.0 and bar.gradient.count("#") > 5


def test_picture_without_ground_fits_any_ground():
    """A picture with opacity laid over a ground is what the renderer draws on that ground."""
    camera = Camera(np.zeros(3), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 2.0, (40, 40))
    corner = np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
    glass = solid(camera, corner, np.array([[0, 1, 2]]), np.array([1.0, 0.0, 0.0]), opacity=0.4)
    block = solid(camera, 0.5 * corner - [1.0, 0.0, 0.0], np.array([[0, 1, 2]]), np.array([0.0, 0.0, 1.0]))
    picture, ground = compose_transparent([glass, block], 1.0), np.array([0.2, 0.5, 0.8])
    over = picture[..., 3:] * picture[..., :3] + (1.0 - picture[..., 3:]) * ground
    np.testing.assert_allclose(over, compose([glass, block], ground, 1.0), atol=0.02)
    assert picture[0, 0, 3] == 0.0 and 0.35 < picture[25, 12, 3] < 0.45
