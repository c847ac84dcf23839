"""The page of a report: one file, with every run in it."""

import re
import sys
import xml.etree.ElementTree as ET
from importlib.metadata import version

import numpy as np
import pytest

from evaluation.measures import StepFacts, facts_of
from evaluation.report_page import DrawnRun, TableText, report_page
from grid_maps.grid_map import GridMap
from tests.unit.evaluation.places import outcome, place

ROOM = GridMap(np.pad(np.zeros((20, 40), np.int8), 1, constant_values=1), 0.5, (-3.0, 2.0, 0.3))
TABLE = TableText(["seed", "error m"], [["0", "0.07"], ["1", "<b>"]])


def step(number: int, x: float, truth_x: float) -> StepFacts:
    found = outcome("localized", place(0.75, (x, 1.0, 0.0), cluster=number % 2))
    return facts_of(number, 0, found, (truth_x, 1.0, 0.0))


def page(*steps: StepFacts) -> str:
    return report_page("cluster-mcl on <sim>", ROOM, [DrawnRun(7, steps)], [TABLE])


def test_the_page_needs_nothing_from_elsewhere() -> None:
    text = page(step(1, 1.0, 1.0))
    assert not re.search(r"""(?:src|href)=["'](?!data:|#)""", text)
    assert "<script" not in text
    assert "http" not in text


def test_names_are_escaped_in_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["clustermcl", "evaluate", "<x>.log"])
    text = page(step(1, 1.0, 1.0))
    assert "<sim>" not in text
    assert "<td><b>" not in text
    assert "&lt;sim&gt;" in text
    command = "<code>clustermcl evaluate &#x27;&lt;x&gt;.log&#x27;</code>"
    assert f"UTC, version {version('clustermcl')}: {command}" in text


def test_every_drawing_is_well_formed() -> None:
    text = page(step(1, 1.0, 1.0), step(2, 9.0, 2.0))
    drawings = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(drawings) == 4  # the map for all; a run's map and two plots
    for drawing in drawings:
        ET.fromstring(drawing)


def test_right_and_wrong_parts_of_the_path_are_drawn_separately() -> None:
    text = page(step(1, 1.0, 1.0), step(2, 1.5, 2.0), step(3, 9.0, 3.0))
    lines = re.findall(r'<polyline points="([^"]+)" fill="none" stroke="(#\w+)"', text)
    assert lines[:2] == [
        ("1.00,1.00 1.50,1.00 1.50,1.00", "#0072B2"),
        ("9.00,1.00 9.00,1.00", "#c0262d"),
    ]


def test_a_jump_is_not_drawn_as_a_path() -> None:
    text = page(step(1, 1.0, 1.0), step(2, 15.0, 15.0))
    assert "1.00,1.00 15.00,1.00" not in text


def test_steps_without_a_place_are_drawn_all_the_same() -> None:
    nothing = facts_of(1, 0, outcome("searching"), (1.0, 1.0, 0.0))
    assert "seed 7" in page(nothing, step(2, 1.0, 1.0))


def test_a_run_without_a_known_truth_is_in_the_table_alone() -> None:
    text = page(facts_of(1, 0, outcome("localized", place(1.0)), None))
    assert "seed 7" not in text
    assert "0.07" in text


def test_the_longest_label_of_a_plot_has_room() -> None:
    off = page(step(1, 0.04, 0.0))
    labels = re.findall(r'<text x="([\d.]+)"[^>]*text-anchor="end">([\d.]+ m)<', off)
    assert [label for _, label in labels] == ["0 m", "0.1 m", "0.2 m"]
    for right_px, label in labels:
        assert float(right_px) > 8.0 * len(label), "a digit of 11 px is up to 7 px wide"
