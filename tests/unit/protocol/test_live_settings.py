import math
from typing import Any

import msgspec
import pytest

from clustermcl.filter.settings import FilterSettings, filter_with, section_with
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.runtime.settings_table import TABLE

SECTIONS = ("bridge", "motion", "sensor")
NUMBERS = (-1, 0, 1e-9, 0.5, 1, 1.5, 2, 65_536, 65_537, 1e9, 1e10, math.nan, math.inf, "1", None)


def setting_of(name: str) -> Any:
    (found,) = [TABLE[f"{one}.{name}"] for one in SECTIONS if f"{one}.{name}" in TABLE]
    (field,) = [f for f in msgspec.structs.fields(found.section) if f.name == name]
    return field.type


def fits(value: object, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


@pytest.mark.parametrize("name", LiveSettings.__struct_fields__)
def test_a_live_setting_accepts_the_finite_values_that_the_setting_accepts(name: str) -> None:
    for value in NUMBERS[:-1]:
        taken = fits({name: value}, LiveSettings)
        if isinstance(value, str) or not abs(value) <= 1e9:
            assert not taken, value
        else:
            assert taken == fits(value, setting_of(name)), value


def test_live_settings_replace_the_settings_of_the_same_names_only() -> None:
    live = LiveSettings(gate_distance_m=0.5, turn_noise_per_turn=0.3, max_beams=9)
    settings = filter_with(FilterSettings(seed=7), live)
    given = FilterSettings(seed=7)
    motion = msgspec.structs.replace(given.motion, turn_noise_per_turn=0.3)
    sensor = msgspec.structs.replace(given.sensor, max_beams=9)
    assert settings == msgspec.structs.replace(given, motion=motion, sensor=sensor)
    changed = section_with(BridgeSettings(rate=3.0), live)
    assert changed == BridgeSettings(rate=3.0, gate_distance_m=0.5)
    assert filter_with(FilterSettings(), AS_STARTED) == FilterSettings()
