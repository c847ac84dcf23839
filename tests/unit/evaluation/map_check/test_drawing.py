"""The page of `clustermcl check --report`."""

import base64
import io
import re
import xml.etree.ElementTree as ET
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from clustermcl.command import app
from evaluation.map_check.drawing import free_bounds, map_page
from evaluation.map_check.report import MapReport, report_of
from grid_maps.grid_map import GridMap
from grid_maps.ros_map import write_map
from particle_filter.arrays import FREE
from robot_simulator.worlds.catalogue import world

CROSS = world("cross").map
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def report() -> MapReport:
    return report_of("<cross>", CROSS, laser_range_m=12.0, places=8, seed=0, agreement=None)


@pytest.fixture(scope="module")
def drawing(report: MapReport) -> str:
    page = map_page(report, ["free: <much>"], CROSS)
    assert "<much>" not in page
    assert "&lt;cross&gt;" in page
    assert "<script" not in page
    assert not re.search(r"""(?:src|href)=["'](?!data:)|http""", page), "it loads nothing else"
    found = re.search(r'<svg class="map".*?</svg>', page, re.DOTALL)
    assert found is not None
    return found[0]


def test_each_place_is_joined_with_all_its_look_alikes(report: MapReport, drawing: str) -> None:
    root = ET.fromstring(drawing)
    joined = sum(len(place.look_alikes) for place in report.places)
    assert joined >= 8, "the arms of the cross look alike"
    turned = [symmetry for symmetry in report.symmetries if symmetry.about_m]
    shifts = len(report.symmetries) - len(turned)
    assert len(list(root.iter("line"))) == joined + shifts
    assert len(list(root.iter("polygon"))) == joined + len(report.places)
    assert len(list(root.iter("circle"))) == len(turned) >= 1


def test_everything_lies_within_the_free_ground_that_is_shown(drawing: str) -> None:
    left, top, width, height = map(float, re.findall(r'viewBox="([^"]+)"', drawing)[0].split())
    points = [
        tuple(map(float, corner.split(",")))
        for corners in re.findall(r'points="([^"]+)"', drawing)
        for corner in corners.split()
    ]
    assert points
    assert all(left <= x <= left + width and top <= -y <= top + height for x, y in points)


def test_the_ground_around_ambiguous_places_is_not_coloured_as_unique(drawing: str) -> None:
    packed = re.findall(r'href="data:image/png;base64,([^"]+)"', drawing)[1]  # after the map
    heat = np.asarray(Image.open(io.BytesIO(base64.b64decode(packed))))
    colours = {tuple(colour) for colour in heat[heat[..., 3] > 0][:, :3].tolist()}
    assert (0xE6, 0x9F, 0x00) in colours, "four arms that look alike"
    assert (0x00, 0x9E, 0x73) not in colours, "no place of the cross is unique"


def test_the_map_is_cropped_to_its_free_ground_however_it_is_turned() -> None:
    cells = np.full((100, 200), -1, np.int8)
    cells[40:60, 100:160] = FREE
    straight = free_bounds(GridMap(cells, 0.1, (0.0, 0.0, 0.0)))
    assert straight == pytest.approx((9.5, 3.5, 16.5, 6.5))
    turned = free_bounds(GridMap(cells, 0.1, (1.0, 2.0, np.pi / 2)))
    assert turned == pytest.approx((-5.5, 11.5, -2.5, 18.5))


def test_the_command_writes_the_page(tmp_path: Path) -> None:
    map_file = write_map(CROSS, tmp_path, "cross")
    page = tmp_path / "cross.html"
    words = ["check", str(map_file), "--places", "2", "--report", str(page)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    text = page.read_text()
    assert f"UTC, version {version('clustermcl')}: <code>clustermcl" in text
    assert "places look alike" in text
    refused = CliRunner().invoke(app, [*words[:-1], str(tmp_path / "no" / "x.html")])
    assert "its folder does not exist" in str(refused.exception)
