"""Shell completion of the values of options.

The functions get the beginning of a value. They import what they need when they are called.
"""

from collections.abc import Iterator
from pathlib import Path


def settings(begun: str) -> Iterator[tuple[str, str]]:
    """Yield the names and meanings of settings, for ``--set``."""
    from process_runtime.settings_table import TABLE  # noqa: PLC0415 - see above

    for name, info in TABLE.items():
        if name.startswith(begun):
            yield f"{name}=", info.meaning


def recordings(begun: str) -> Iterator[str]:
    """Return the names of simulated worlds and of files."""
    from process_runtime.sources import SIMULATED  # noqa: PLC0415 - see above
    from robot_simulator.worlds.catalogue import world_names  # noqa: PLC0415 - see above

    offered = [f"{SIMULATED}{name}" for name in world_names()]
    folder = Path(begun).parent if begun else Path()
    offered += [str(path) for path in folder.glob("*")] if folder.is_dir() else []
    return (name for name in sorted(offered) if name.startswith(begun))


def algorithms(begun: str) -> Iterator[str]:
    """Return the names of the algorithms of `evaluate`."""
    from evaluation.run import ALGORITHMS  # noqa: PLC0415 - see above

    return (name for name in ALGORITHMS if name.startswith(begun))
