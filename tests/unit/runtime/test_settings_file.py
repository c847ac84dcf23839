import time
import tomllib
from pathlib import Path
from typing import Annotated, get_args, get_origin

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.settings_table import EVERYDAY, TABLE, SettingInfo, settings_as_toml

TEXT = st.text(st.sampled_from("az AZ09/\"'\\#=[]{}\n\r\t\0\x1b\x7f\x85é€😀\u2028"), max_size=20)


def write(folder: Path, text: str) -> Path:
    file = folder / "settings.toml"
    file.write_text(text)
    return file


def complaint(*assignments: str, path: Path | None = None) -> str:
    with pytest.raises(ClusterMclError) as caught:
        load_settings(path, assignments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def values_of(info: SettingInfo) -> st.SearchStrategy[bool | int | float | str]:
    key = info.name.rpartition(".")[2]
    (field,) = [each for each in msgspec.structs.fields(info.section) if each.name == key]
    is_bounded = get_origin(field.type) is Annotated
    plain, meta = get_args(field.type) if is_bounded else (field.type, msgspec.Meta())
    if choices := get_args(plain):
        return st.sampled_from(choices)
    over, least = meta.gt, meta.ge
    if plain is int:
        least = over + 1 if over is not None else least
        return st.integers(least, 2**63 - 1 if meta.le is None else meta.le)
    if plain is float:
        low = over if over is not None else least
        return st.floats(
            -1e18 if low is None else low,
            next((m for m in (meta.le, meta.lt) if m is not None), 1e18),
            exclude_min=over is not None,
            exclude_max=meta.lt is not None,
        )
    if meta.pattern is not None:
        short = meta.pattern.replace("*", "{0,2}").replace("+", "{1,2}")
        return st.from_regex(short).filter(lambda text: len(text) <= meta.max_length)
    return st.booleans() if plain is bool else TEXT


@st.composite
def any_settings(draw: st.DrawFn) -> Settings:
    tables: dict[str, object] = {}
    changed = draw(st.lists(st.sampled_from(sorted(TABLE)), max_size=8, unique=True))
    for name in changed:
        section, _, key = name.rpartition(".")
        value = draw(values_of(TABLE[name]))
        table = tables.setdefault(section, {}) if section else tables
        assert isinstance(table, dict)
        table[key] = value
    return msgspec.convert(tables, Settings)


@given(settings=any_settings())
def test_settings_written_as_toml_are_read_back_the_same(
    settings: Settings, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "round-trip.toml"
    file.write_bytes(settings_as_toml(settings).encode())
    assert load_settings(file, []) == settings


@given(name=st.sampled_from(sorted(TABLE)), data=st.data())
def test_every_setting_can_be_given_on_the_command_line(name: str, data: st.DataObject) -> None:
    # Blanks around a value are not part of it, and tf's frames have no slash in front.
    value = data.draw(values_of(TABLE[name]).filter(lambda v: str(v) == str(v).strip().lstrip("/")))
    section, _, key = name.rpartition(".")
    text = str(value).lower() if isinstance(value, bool) else str(value)
    if isinstance(value, str) and text.startswith(('"', "'")):
        return  # quoted text is TOML: another test
    settings = load_settings(None, [f"{name}={text}"])
    part = getattr(settings, section) if section else settings
    assert getattr(part, key) == value


def test_the_command_line_overrides_the_file_and_later_options_override_earlier_ones(
    tmp_path: Path,
) -> None:
    file = write(tmp_path, "seed = 1\n[cluster]\nparticles = 10\n")
    settings = load_settings(file, ["cluster.particles=20", "cluster.particles = 30"])
    assert (settings.seed, settings.cluster.particles) == (1, 30)


def test_text_settings_need_no_quotes_and_may_have_several_lines() -> None:
    given = ["robot.name=7", "bridge.map=maps/wean.dat", "bridge.landmarks='a'\nseed=5"]
    settings = load_settings(None, [*given, 'bridge.source="a b"'])
    assert (settings.robot.name, settings.seed) == ("7", 0)
    bridge = settings.bridge
    assert (bridge.map, bridge.source, bridge.landmarks) == (
        "maps/wean.dat", "a b", "'a'\nseed=5",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("cluster.partcles=5", "unknown setting cluster.partcles, did you mean cluster.particles?"),
        ("max_clusters=5", "unknown setting max_clusters, did you mean belief.max_clusters?"),
        ("belief.kidnapping_probability=1", "expected a number >= 0 and < 1"),
        ("qqqq=5", "unknown setting qqqq; 'clustermcl settings --all' lists all"),
        ("motion=5", "motion is a section: give motion.KEY"),
        ("cluster.particles=abc", "cluster.particles = 'abc': expected a whole number > 0"),
        ("cluster.particles=1000000000000", "expected a whole number > 0 and <= 1000000"),
        ("sensor.hit_weight=1.5", "hit_weight = 1.5: expected a number > 0 and <= 1"),
        ("sensor.hit_sigma_m=nan", "sensor.hit_sigma_m = nan: expected a number > 0"),
        ("bridge.rate=inf", "bridge.rate = inf: expected a number >= 0"),
        ("seed=18446744073709551616", "seed = 18446744073709551616: expected a whole number"),
        ("motion.model=omni", 'motion.model = \'omni\': expected "omnidirectional" or "differ'),
        ("bridge.rate", "--set 'bridge.rate': write section.key=value"),
        ("=1", "--set '=1': write section.key=value"),
    ],
)
def test_a_wrong_assignment_is_named_with_what_was_expected(assignment: str, message: str) -> None:
    assert message in complaint(assignment)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[motoin]\nmodel = 1", "unknown setting motoin.model, did you mean motion.model?"),
        ("motion = 3", "motion is a section: give motion.KEY"),
        ("[cluster.particles]\nmany = 1", "cluster.particles = {'many': 1}: expected a whole"),
    ],
)
def test_a_wrong_setting_in_a_file_is_named_with_the_file(
    text: str, message: str, tmp_path: Path
) -> None:
    file = write(tmp_path, text)
    assert complaint(path=file).startswith(f"{file}: {message}")


def test_a_file_that_is_not_toml_is_named_with_the_line(tmp_path: Path) -> None:
    file = write(tmp_path, "seed = 1\n[motion\n")
    assert complaint(path=file).startswith(f"{file}:2: not TOML: Expected ']'")
    file.write_bytes(b"seed = 1 # \xff")
    assert complaint(path=file) == f"{file}: not TOML: not UTF-8 text"
    assert complaint(path=tmp_path / "none.toml").startswith(f"{tmp_path}/none.toml: no such file")


@pytest.mark.parametrize("parts", [1_000, 200_000])
def test_a_key_of_very_many_parts_is_refused_before_it_is_parsed(
    parts: int, tmp_path: Path
) -> None:
    """Of 200,000 parts tomllib takes 40 s."""
    file = write(tmp_path, "seed = 1\n" + "a." * (parts - 1) + "a = 1\n")
    began = time.process_time()
    assert complaint(path=file) in (
        f"{file}:2: a line of {2 * parts + 3} characters; at most 1000 are read",
        f"{file}: longer than 0.25 MiB unpacked, more than any such input",
    )
    assert time.process_time() - began < 1.0, "a fraction of that"


@pytest.mark.parametrize("name", ["", "r/7", "r.7", "Büro", '"r\\n"', "x" * 65])
def test_a_robots_name_that_is_no_part_of_a_key_is_refused(name: str) -> None:
    rule = "expected letters, digits, _ and single - between them, at most 64"
    assert complaint(f"robot.name={name}").endswith(rule)
    assert load_settings(None, ["robot.name=R_7-b"]).robot.name == "R_7-b"


def test_a_short_file_has_an_operators_settings_and_those_that_were_changed() -> None:
    changed = load_settings(None, ["belief.least_probability=0.5"])
    text = settings_as_toml(changed, EVERYDAY)
    names = {
        f"{section}.{key}" if isinstance(values, dict) else section
        for section, values in tomllib.loads(text).items()
        for key in (values if isinstance(values, dict) else [""])
    }
    assert names == EVERYDAY | {"belief.least_probability"}
