"""All sensor models by the name that `sensor.model` has for them."""

from typing import assert_never

from particle_filter.beam_model import BeamModel
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.sensor_model import Grid, SensorModel
from particle_filter.settings import SensorModelName, SensorSettings


def model_class(name: SensorModelName) -> type[SensorModel]:
    """The class of the model that the settings name."""
    match name:
        case "likelihood_field":
            return LikelihoodFieldModel
        case "beam":
            return BeamModel
        case _:
            assert_never(name)


def computed_model(grid: Grid, settings: SensorSettings) -> SensorModel:
    """The model of a map, computed anew.

    Raises:
        ValueError: the map has no obstacle.
    """
    kind = model_class(settings.model)
    return kind.from_arrays(grid, kind.arrays_of(grid, settings), settings)
