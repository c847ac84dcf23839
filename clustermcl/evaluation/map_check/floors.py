"""Remarks on a building: floors that look alike, and links that end in a wall."""

from collections import Counter
from collections.abc import Iterable, Iterator

from clustermcl.filter.arrays import FREE
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap


def floor_remarks(groups: Iterable[tuple[PoseTuple, ...]], grid_map: GridMap) -> Iterator[str]:
    """Yield remarks as sentences.

    Args:
        groups: poses that look alike, of which the first was tested, in the atlas.
        grid_map: the building.
    """
    floors = grid_map.floors
    tested, alike = Counter[str](), Counter[tuple[str, str]]()
    for pose, *others in groups:
        here, _ = floors.on_floor(pose)
        tested[here] += 1
        alike.update({(here, floors.on_floor(other)[0]) for other in others})
    for (here, there), count in sorted(alike.items()):
        if here != there:
            yield (
                f"{count} of {tested[here]} places on floor {here} look like places on floor "
                f"{there}: until something distinguishes them, the floor is ambiguous; an "
                "observation of the floor does (docs/tutorials/floors.md)"
            )
    for link in floors.links:
        for name, (x, y) in link.at.items():
            across, up, _ = floors.in_atlas(name, (x, y, 0.0))
            if grid_map.cells[int(up / grid_map.cell_m), int(across / grid_map.cell_m)] != FREE:
                place = f"x {x:.2f} m, y {y:.2f} m is not free ground"
                yield f"link {link.name} ends in a wall on floor {name}: {place}"
