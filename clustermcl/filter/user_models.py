"""Models of users. The filter only looks them up; `runtime.extensions` loads their code."""

from collections.abc import Mapping
from typing import Any

table: Mapping[tuple[str, str], Any] = {}
"""By kind and name: ``("sensor_model", "near_only")``."""
