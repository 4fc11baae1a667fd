"""The noise of the twin's URG-04LX beside that of a real one, by the same statistics.

``python benchmarks/sensor_statistics.py LOG [--json]`` reads a log of a sensor that stands,
rebuilds the room of each standing stretch from the walls that it saw (``sensor_log``), lets the
twin's sensor read as many lines from the same place, and prints each statistic of both. The twin's
noise was fitted to the sd, the correlations, ``flicker`` and ``code 7`` of the same log; ``equal
neighbours``, ``mixed pixels`` and ``equal threes`` follow from its running median.

Only standing lines count. Distances beyond 4095 mm, which the twin does not send, are code 0 in the
log too. A *block* is one sector of ``SECTOR`` steps of one stretch: 11 deg, which one or two
surfaces fill, while noise is correlated over 4 steps. Intervals hold 95 % of ``DRAWS`` bootstrap
draws of blocks with replacement, as many from each stretch as it has. A *wall step* is the middle
of ``2 HALF_WINDOW + 1`` steps that have a distance in all lines of the stretch, never stray by more
than ``STILL_MM`` from their median (someone walks through the log), and whose mean points lie on
a line within ``MAX_RMS_MM``; this line gives the incidence. Numerators / denominators:

* ``sd A-B m C-D deg``: the median over the wall steps of these ranges and incidences of the
  standard deviation over the lines of a stretch [mm];
* ``equal neighbours``: pairs of adjacent wall steps with equal readings / such pairs;
* ``correlation at lag K``: the mean over pairs of wall steps K apart of the correlation coefficient
  of their readings over the lines of a stretch, weighted by the lines less one;
* ``mixed pixels``: distances more than 10 mm inside those of their two neighbours, which differ by
  more than 150 mm / distances;
* ``isolated dropouts``: codes between two distances that differ by at most 150 mm / distances;
* ``code N``: readings of this code / readings; ``codes 1 2`` are weak returns, of which the twin
  sends only 1;
* ``equal threes``: groups of three distances between codes that are all equal / such groups;
* ``flicker``: steps with a distance in just one of two successive lines / steps in pairs of lines;
* ``revolution``: mean time between two lines [ms]: in the log between all lines by the host's
  clock, in blocks of 20; in the twin that of its mean sensor.

What depends on range and incidence is ``inside`` where the twin lies in the real interval; what
depends on edges and dark surfaces where it lies within a factor of 2 of the real value, on the
assumption ``REFLECTANCES``. Where the real interval is wider than a factor of 2, whatever it is
compared to, the verdict is ``not decided``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from sensor_log import (
    ANGLES,
    JUMP_MM,
    LIDAR_HEIGHT,
    MARGIN_MM,
    Reflectances,
    Stretch,
    Wall,
    assign_reflectances,
    build_unseen_walls,
    fit_walls,
    read_stretches,
    write_room,
)

from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.device import URG04LX
from scan3d_twin.sim.config import WORLDS, TwinConfig
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.scanner import Scanner
from scan3d_twin.sim.ray_casting import choose_caster
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

REFLECTANCES = Reflectances(seen=0.2, seen_spread=1.0, unseen=0.02, unseen_spread=0.15)
"""The one assumption on reflectance; a log does not tell it. Unseen surfaces return on average a
third of the threshold, so that single steps of them are detected now and then, as in the log."""
SECTOR = 31
HALF_WINDOW, MAX_RMS_MM = 4, 10.0
STILL_MM = 50.0
DRAWS = 2000
BINS = ((0.5, 1, 0, 30), (0.5, 1, 30, 60), (1, 2, 0, 30), (1, 2, 30, 60), (2, 3, 30, 60),
        (3, 4, 0, 30))  # fmt: skip
"""Ranges [m] and incidences [deg] of the standard deviations."""
MIN_STEPS = 20
"""Fewest steps of a bin."""
LAGS = (1, 2, 3)
CODES = ((0,), (1, 2), (6,), (7,), (8,), (10,))
LINES_PER_BLOCK = 20
"""Lines of a block of times; the host is up to half a line late or early."""
TWIN_LINES = 60
"""Lines by which the twin's period is measured."""
SMOOTH, EDGES = "range and incidence", "edges and dark surfaces"
"""What a statistic depends on."""


@dataclass(frozen=True)
class Block:
    """What one sector of one stretch adds to each statistic.

    Attributes:
        stretch: Index of the stretch.
        sums: Numerator and denominator by the name of the share.
        spreads: Standard deviations of wall steps [mm], by the name of the bin.
    """

    stretch: int
    sums: dict[str, tuple[float, float]]
    spreads: dict[str, FloatArray]


@dataclass(frozen=True)
class Row:
    """One statistic of both sensors, and the verdict."""

    name: str
    kind: str
    real: float
    low: float
    high: float
    twin: float

    @property
    def verdict(self) -> str:
        """``inside``, ``outside``, or ``not decided``."""
        if not self.low > 0 or self.high > 2 * self.low:
            return "not decided"
        low, high = self.low, self.high
        if self.kind == EDGES:
            low, high = self.real / 2, 2 * self.real
        return "inside" if low <= self.twin <= high else "outside"


@dataclass(frozen=True)
class WallSteps:
    """The steps of a stretch that lie on a wall.

    Attributes:
        on_wall: Which steps do (682,).
        distance: Mean distance of each step (682,) [mm].
        incidence: Angle of incidence (682,) [deg].
    """

    on_wall: BoolArray
    distance: FloatArray
    incidence: FloatArray

    @staticmethod
    def of(readings: IntArray) -> WallSteps:
        """Return the wall steps that the lines ``readings`` (m, 682) show."""
        good = (readings >= urg04lx.MIN_RANGE_MM).all(axis=0)
        good &= np.abs(readings - np.median(readings, axis=0)).max(axis=0) <= STILL_MM
        distance = readings.mean(axis=0)
        rays = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
        points = distance[:, None] * rays
        on_wall, incidence = np.zeros(len(good), dtype=bool), np.zeros(len(good))
        for step in range(HALF_WINDOW, len(good) - HALF_WINDOW):
            window = slice(step - HALF_WINDOW, step + HALF_WINDOW + 1)
            if good[window].all():
                near = points[window]
                spread, axes = np.linalg.svd(near - near.mean(axis=0))[1:]
                on_wall[step] = spread[1] <= MAX_RMS_MM * math.sqrt(len(near))
                incidence[step] = math.degrees(math.acos(min(1.0, abs(axes[1] @ rays[step]))))
        return WallSteps(on_wall, distance, incidence)


def make_blocks(index: int, readings: IntArray, steps: WallSteps) -> list[Block]:
    """Return the blocks of the lines ``readings`` (m, 682) of one stretch."""
    valid = readings >= urg04lx.MIN_RANGE_MM
    shares = count_shares(readings, valid)
    spreads, on_walls = measure_walls(readings, valid, steps)
    shares.update(on_walls)
    blocks = []
    for first in range(0, readings.shape[1], SECTOR):
        part = slice(first, first + SECTOR)
        sums = {
            name: (float(hits[part].sum()), float(total[part].sum()))
            for name, (hits, total) in shares.items()
        }
        inside = {name: values[part][np.isfinite(values[part])] for name, values in spreads.items()}
        blocks.append(Block(index, sums, inside))
    return blocks


Shares = dict[str, tuple[FloatArray, FloatArray]]
"""Numerator and denominator of each step (682,), by name."""


def count_shares(readings: IntArray, valid: BoolArray) -> Shares:
    """Return what depends on edges and dark surfaces."""
    left, middle, right = readings[:, :-2], readings[:, 1:-1], readings[:, 2:]
    ends = valid[:, :-2] & valid[:, 2:]
    jump = np.abs(right - left) > JUMP_MM
    low, high = np.minimum(left, right) + MARGIN_MM, np.maximum(left, right) - MARGIN_MM
    mixed = ends & valid[:, 1:-1] & jump & (low < middle) & (middle < high)
    dropout = ends & ~valid[:, 1:-1] & ~jump

    threes = ~valid[:, :-4] & valid[:, 1:-3] & valid[:, 2:-2] & valid[:, 3:-1] & ~valid[:, 4:]
    same = threes & (left[:, 1:-1] == middle[:, 1:-1]) & (middle[:, 1:-1] == right[:, 1:-1])

    def pad(flags: BoolArray) -> FloatArray:
        """Return the number of lines with each flag, for all steps (682,)."""
        missing = (readings.shape[1] - flags.shape[1]) // 2
        return np.pad(flags.sum(axis=0).astype(float), missing)

    distances = valid.sum(axis=0).astype(float)
    everything = np.full(readings.shape[1], float(len(readings)))
    flicker = (valid[1:] != valid[:-1]).sum(axis=0).astype(float)
    result = {
        "mixed pixels": (pad(mixed), distances),
        "isolated dropouts": (pad(dropout), distances),
        "equal threes": (pad(same), pad(threes)),
        "flicker": (flicker, everything - 1),
    }
    for codes in CODES:
        hits = np.isin(readings, codes).sum(axis=0).astype(float)
        result[name_codes(codes)] = (hits, everything)
    return result


def name_codes(codes: tuple[int, ...]) -> str:
    """Return the name of the share of ``codes``."""
    return f"code{'s' if len(codes) > 1 else ''} {' '.join(map(str, codes))}"


def name_bin(bounds: tuple[float, float, float, float]) -> str:
    """Return the name of a bin of range [m] and incidence [deg]."""
    return "sd {:g}-{:g} m {:g}-{:g} deg".format(*bounds)


def measure_walls(
    readings: IntArray, valid: BoolArray, steps: WallSteps
) -> tuple[dict[str, FloatArray], Shares]:
    """Return what depends on range and incidence: sd of each step by bin [mm], and shares."""
    good = steps.on_wall & valid.all(axis=0)
    sd = readings.std(axis=0, ddof=1)
    spreads = {}
    for bounds in BINS:
        near, far, flat, steep = bounds
        here = good & (steps.distance >= 1000 * near) & (steps.distance < 1000 * far)
        here &= (steps.incidence >= flat) & (steps.incidence < steep)
        spreads[name_bin(bounds)] = np.where(here, sd, np.nan)

    # Pairs of steps on one wall
    shares, n = {}, readings.shape[1]
    off = readings - readings.mean(axis=0)
    scaled = off / np.maximum(np.sqrt((off**2).sum(axis=0)), 1e-12)
    for lag in LAGS:
        pair = good[lag:] & good[:-lag]
        varies = pair & (sd[lag:] > 0) & (sd[:-lag] > 0)
        weight = np.zeros(n)
        weight[: n - lag] = varies * (len(readings) - 1)
        product = np.zeros(n)
        product[: n - lag] = (scaled[:, lag:] * scaled[:, :-lag]).sum(axis=0)
        shares[f"correlation at lag {lag}"] = (product * weight, weight)
        if lag == 1:
            equal, count = np.zeros(n), np.zeros(n)
            equal[:-1] = pair * (readings[:, 1:] == readings[:, :-1]).sum(axis=0)
            count[:-1] = pair * len(readings)
            shares["equal neighbours"] = (equal, count)
    return spreads, shares


def list_statistics() -> dict[str, str]:
    """Return what each statistic depends on, in the order of the table."""
    smooth = [*map(name_bin, BINS), "equal neighbours"]
    smooth += [f"correlation at lag {lag}" for lag in LAGS]
    edges = [
        "mixed pixels",
        "isolated dropouts",
        "equal threes",
        "flicker",
        *map(name_codes, CODES),
    ]
    return dict.fromkeys(smooth, SMOOTH) | dict.fromkeys(edges, EDGES)


def evaluate(name: str, blocks: Sequence[Block]) -> float:
    """Return the statistic ``name`` of ``blocks``; NaN where there is too little."""
    if name in blocks[0].spreads:
        values = np.concatenate([block.spreads[name] for block in blocks])
        return float(np.median(values)) if len(values) >= MIN_STEPS else math.nan
    top = sum(block.sums[name][0] for block in blocks)
    under = sum(block.sums[name][1] for block in blocks)
    return top / under if under > 0 else math.nan


def bootstrap(name: str, blocks: Sequence[Block], rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of a statistic over draws of blocks within stretches."""
    groups = [
        [block for block in blocks if block.stretch == index]
        for index in sorted({block.stretch for block in blocks})
    ]
    values = []
    for _ in range(DRAWS):
        drawn = [g[k] for g in groups for k in rng.integers(0, len(g), len(g))]
        values.append(evaluate(name, drawn))
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(low), float(high)


def read_twin(stretch: Stretch, walls: list[Wall], config: LidarModelConfig, seed: int) -> IntArray:
    """Return as many lines as the stretch has (m, 682), by the twin in its rebuilt room."""
    # Rebuild the room
    rng = np.random.default_rng([seed, 0])
    painted = assign_reflectances(walls, REFLECTANCES, config.threshold, rng)
    room = painted + build_unseen_walls(stretch, walls, REFLECTANCES, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.xml"
        path.write_text(write_room(room))
        scene = load_scene(str(path))

    # Lay the sensor flat: its upright line becomes level
    spec, count = URG04LX.spec("usb"), len(stretch.readings)
    caster = choose_caster(scene.model)
    scanner = Scanner(scene.model, None, spec, config, caster, rng, URG04LX.sensor)
    flat = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    positions = np.broadcast_to([0.0, 0.0, LIDAR_HEIGHT], (count, spec.n_beams, 3))
    rotations = np.broadcast_to(flat, (count, spec.n_beams, 3, 3))

    # Read the lines
    rngs = [np.random.default_rng([seed, 1, line]) for line in range(count)]
    draws = Draws.of(rngs, spec.n_beams, config)
    seen = scanner.measure(np.empty(0), positions, rotations, draws, np.zeros(count))
    millimetres = np.rint(1000 * np.nan_to_num(seen.ranges)).astype(np.int64)
    return np.where(seen.codes == VALID, millimetres, seen.codes)


def compare_revolution(times: FloatArray, config: LidarModelConfig) -> Row:
    """Return the row of the mirror's period [ms], of the host's ``times`` (n,) [s]."""
    # Bootstrap the log's blocks
    steps = np.diff(times)
    blocks = steps[: len(steps) // LINES_PER_BLOCK * LINES_PER_BLOCK]
    means = blocks.reshape(-1, LINES_PER_BLOCK).mean(axis=1)
    rng = np.random.default_rng(0)
    drawn = means[rng.integers(0, len(means), (DRAWS, len(means)))].mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])

    # Measure the twin's mean sensor
    mean_sensor = TwinConfig(lidar=replace(config, revolution=0.0, line_loss=0.0))
    with open_sim("plain_wall", 0, mean_sensor) as (robot, _):
        stamps = [robot.lidar.read_line(1.0).stamp for _ in range(TWIN_LINES)]
    twin = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
    values = np.array([steps.mean(), low, high, twin]) * 1000
    return Row("revolution", SMOOTH, *map(float, values))


def compare(path: Path, config: LidarModelConfig, seeds: int) -> list[Row]:
    """Return all rows, of a log and of ``seeds`` sensors of the twin."""
    # Read both sensors
    stretches, times = read_stretches(path)
    real: list[Block] = []
    twin: list[Block] = []
    for index, stretch in enumerate(stretches):
        steps, walls = WallSteps.of(stretch.readings), fit_walls(stretch)
        real += make_blocks(index, stretch.readings, steps)
        for seed in range(seeds):
            twin += make_blocks(index, read_twin(stretch, walls, config, seed), steps)

    # Compare them
    rng = np.random.default_rng(0)
    rows = [
        Row(name, kind, evaluate(name, real), *bootstrap(name, real, rng), evaluate(name, twin))
        for name, kind in list_statistics().items()
    ]
    return [*rows, compare_revolution(times, config)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--world", choices=WORLDS, default="typical")
    parser.add_argument("--seeds", type=int, default=8, help="number of the twin's sensors")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = compare(options.log, WORLDS[options.world][0], options.seeds)
    if options.json:
        print(json.dumps({row.name: {**asdict(row), "verdict": row.verdict} for row in rows}))
        return
    for kind in (SMOOTH, EDGES):
        print(f"\n{kind:24} {'real':>8} {'95 % interval':>18} {'twin':>8}")
        for row in (row for row in rows if row.kind == kind):
            interval = f"{row.low:.4f} {row.high:.4f}"
            print(f"{row.name:24} {row.real:8.4f} {interval:>18} {row.twin:8.4f} {row.verdict}")


if __name__ == "__main__":
    main()
