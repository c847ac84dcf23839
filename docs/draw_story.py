"""Draws docs/story.png: the demo's robot in the cross, by ordinary MCL and by Cluster-MCL.

python docs/draw_story.py
"""

from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from benchmarks.experiments.baselines import ALGORITHMS
from clustermcl.belief.outcome import belief_after
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import SimulatedSource, simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.drawing import drawn_picture
from clustermcl.view.frames import step_frame

HERE = Path(__file__).parent
SIDE_PX, STEPS = 420, 190
SHOWN: tuple[tuple[str, int], ...] = (
    ("mcl", 100),
    ("cluster-mcl", 100),
    ("cluster-mcl", 188),
)
NAMES = {"mcl": "ordinary MCL", "cluster-mcl": "Cluster-MCL"}


def main() -> None:
    """Run both and draw three moments."""
    moments = [moment(algorithm, step) for algorithm, step in SHOWN]
    width, height = moments[0].size
    strip = Image.new("RGB", (len(moments) * width, height))
    for index, picture in enumerate(moments):
        strip.paste(picture, (index * width, 0))
    strip.quantize(128, Image.Quantize.MAXCOVERAGE).save(HERE / "story.png", optimize=True)


def moment(algorithm: str, step: int) -> Image.Image:
    """The map after a step of the demo's run."""
    place, settings = world("cross_feature"), FilterSettings()
    source = SimulatedSource(Simulation(place, settings.seed), steps=STEPS)
    steps = list(simulated_steps(source, BridgeSettings(), place.map.digest))[: step + 1]
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    *_, (scan, outcome) = ALGORITHMS[algorithm]((scan for scan, _ in steps), model, settings)
    slots = {hypothesis.cluster: index for index, hypothesis in enumerate(outcome.hypotheses)}
    frame = step_frame(belief_after(scan, outcome, "story"), slots, scan, steps[-1][1])
    picture = drawn_picture(place.map, frame, SIDE_PX)
    for line, words in enumerate((NAMES[algorithm], f"step {step}", outcome.state)):
        font = ImageFont.load_default(16)
        ImageDraw.Draw(picture).text((12, 10 + 20 * line), words, "#1a2027", font)
    return picture


if __name__ == "__main__":
    main()
