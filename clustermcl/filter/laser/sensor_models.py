"""Finds a sensor model's class by its name in the setting `sensor.model`."""

from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_model import BeamModel
from clustermcl.filter.laser.likelihood_field_model import LikelihoodFieldModel
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import SensorSettings, user_models

OWN: dict[str, type[SensorModel]] = {
    "likelihood_field": LikelihoodFieldModel,
    "beam": BeamModel,
}


def model_class(name: str) -> type[SensorModel]:
    """Return the class of the named model.

    Raises:
        ValueError: no model has this name, or its code cannot be imported.
    """
    return OWN.get(name) or user_models["sensor_model", name]


def computed_model(grid: Grid, settings: SensorSettings) -> SensorModel:
    """Compute the model of a map.

    Raises:
        ValueError: the map has no obstacle, or no model has the name in the settings.
    """
    kind = model_class(settings.model)
    return kind.from_arrays(grid, kind.arrays_of(grid, settings), settings)
