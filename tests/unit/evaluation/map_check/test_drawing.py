from pathlib import Path

from PIL import Image, ImageColor
from typer.testing import CliRunner

from clustermcl.commands.command import app
from clustermcl.evaluation.map_check.drawing import COLOURS, LANDMARK
from clustermcl.protocol.errors import SettingsError
from clustermcl.simulator.worlds.catalogue import world
from tests.maps import write_map

UNIQUE, ONE, SOME, MANY = (colour for _, colour in COLOURS)


def colours_of(name: str, folder: Path) -> set[tuple[int, ...]]:
    """The colours of the picture that the command writes of a world's map."""
    map_file, picture = write_map(world(name).map, folder, name), folder / f"{name}.png"
    words = ["check", str(map_file), "--places", "8", "--report", str(picture)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    with Image.open(picture) as drawn:
        assert max(drawn.size) > 1000
        return {colour for _, colour in drawn.convert("RGB").getcolors(2**24)}


def test_picture_and_legend_show_how_many_places_look_alike(tmp_path: Path) -> None:
    """The cross has four equal arms; in the hall all places differ."""
    cross, hall = colours_of("cross", tmp_path), colours_of("hall", tmp_path)
    rgb = ImageColor.getrgb
    assert rgb(SOME) in cross
    assert rgb(UNIQUE) not in cross, "no place of the cross is unique"
    assert rgb(UNIQUE) in hall


def test_landmarks_are_drawn_and_those_outside_the_map_are_remarked(tmp_path: Path) -> None:
    lines = "- {id: in, x: 0.0, y: 0.0}\n- {id: far, x: 900.0, y: 0.0}\n"
    (tmp_path / "landmarks.yaml").write_text(f"landmarks:\n{lines}")
    assert ImageColor.getrgb(LANDMARK) in colours_of("cross", tmp_path)
    printed = CliRunner().invoke(app, ["check", str(tmp_path / "cross.yaml"), "--places", "1"])
    assert "1 of 2 landmarks lie outside the map, such as far" in printed.output


def test_an_unwritable_picture_is_refused_before_the_check(tmp_path: Path) -> None:
    map_file = write_map(world("cross").map, tmp_path, "cross")
    words = ["check", str(map_file), "--report"]
    refused = CliRunner().invoke(app, [*words, str(tmp_path / "no" / "x.png")])
    assert "its folder does not exist" in str(refused.exception)
    page = CliRunner().invoke(app, [*words, str(tmp_path / "x.html")]).exception
    assert isinstance(page, SettingsError)
