"""The compiled engine: each function against its plain form, and what crosses the border."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import degenerate_pairs
import numpy as np
import pytest
import reference.algebra
import reference.edges
import reference.extract_surfels
import reference.floor
import reference.free_space
import reference.gauss_newton
import reference.grids
import reference.point_to_plane
import reference.pose_prior
import reference.projection
import reference.readings
import reference.scan_arrays
import reference.scan_noise
import reference.shared_errors
import reference.surfels
import synthetic

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.grids import dilate, label_cells
from scan3d_twin.core.navigation.costmap import RESOLUTION
from scan3d_twin.core.planning.prediction.virtual_scan import _list_rays
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.algebra import find_determined, invert_information, marginalise
from scan3d_twin.core.registration.clouds.pairs import PAIR
from scan3d_twin.core.registration.clouds.patches import WINDOW_RADII, prepare_cloud
from scan3d_twin.core.registration.gauss_newton import (
    Criteria,
    Problem,
    RunResult,
    align,
    follow_starts,
)
from scan3d_twin.core.registration.kd_tree import Tree, is_near
from scan3d_twin.core.registration.multistart import spread_starts
from scan3d_twin.core.registration.native import Engine, engine
from scan3d_twin.core.registration.native.arguments import Doubles, address_of
from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.pose_prior import PosePrior, deviation, displace, predict_rmse
from scan3d_twin.core.registration.surfels.edges import Edges, linearise_edges
from scan3d_twin.core.registration.surfels.extraction import (
    EMPTY_RAY,
    Beams,
    fit_surfels,
    make_native_sweep,
)
from scan3d_twin.core.registration.surfels.free_space import (
    _sum_violations,
    find_contradicted_share,
)
from scan3d_twin.core.registration.surfels.grid import SurfelGrid, extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise, estimate_noise
from scan3d_twin.core.registration.surfels.sweep_points import SweepPoints
from scan3d_twin.core.scanning.calibration.extrinsics import apply_mount
from scan3d_twin.core.types import UNMEASURED, VALID, FloatArray, Pose2, RangeImage, read_only

FIRST, SECOND = Pose2(0.0, 0.15, -0.05), Pose2(0.02, -0.15, 0.10)
MOVE = FIRST.inverse() @ SECOND
SIGMA = 0.005
NATIVE = Path(native.__file__).parent


@cache
def image(seed: int, jitter: float = 0.0) -> RangeImage:
    rng = np.random.default_rng(seed)
    taken = synthetic.observe(FIRST if seed == 1 else SECOND, sigma=SIGMA, rng=rng).image
    shaken = taken.yaws + jitter * rng.standard_normal(taken.n_lines)[:, None]
    return replace(taken, yaws=read_only(shaken))


@cache
def grids(
    yaw_scale_sigma: float = 0.01, bias_sigma: float = 0.002
) -> tuple[SurfelGrid, SurfelGrid]:
    """Two sweeps that have everything: range noise, jitter, a yaw scale, shared errors, edges."""
    made = (extract_surfels(image(seed, 0.001)) for seed in (1, 2))
    shared = {
        "yaw_scale_sigma": yaw_scale_sigma,
        "bias_sigma": bias_sigma,
        "linearity_sigma": 0.004,
        "offset_sigma": 0.003,
        "correlation": 1.4,
    }
    first, second = (replace(grid, noise=replace(grid.noise, **shared)) for grid in made)
    assert first.noise.yaw_sigma > 0
    assert second.noise.yaw_sigma > 0
    return first, second


def plain_projection(grid: SurfelGrid) -> reference.projection.Projection:
    p = grid.projection
    return reference.projection.Projection(
        p.lines, p.beams, p.yaws, p.middles, p.mount, p.backwards
    )


def plain_target(grid: SurfelGrid) -> reference.scan_arrays.Target:
    return reference.scan_arrays.Target(
        grid.rows, grid.yaws, grid.index.reshape(-1), plain_projection(grid)
    )


def plain_sample(grid: SurfelGrid, stride: int) -> reference.scan_arrays.Sample:
    found = reference.scan_arrays.sampled(grid.rows, grid.yaws, grid.index, stride)
    return reference.scan_arrays.Sample(*found, stride)


def plain_noise(target: SurfelGrid, source: SurfelGrid) -> reference.point_to_plane.PairNoise:
    return reference.point_to_plane.PairNoise(
        source.noise.yaw_sigma**2,
        target.noise.yaw_sigma**2,
        target.line_spacing / source.line_spacing,
        2.0 / (source.inflation + target.inflation),
        (source.noise.tilt_variance + target.noise.tilt_variance) / 4,
        max(source.noise.bias_sigma, target.noise.bias_sigma),
        max(source.noise.linearity_sigma, target.noise.linearity_sigma),
        max(source.noise.offset_sigma, target.noise.offset_sigma),
        (source.noise.correlation + target.noise.correlation) / 2,
        0.001,
        0.002,
        0.05,
        0.3,
    )


def near(a: FloatArray, b: FloatArray, relative: float = 1e-9) -> bool:
    """Return whether two arrays are the same but for rounding of their largest entries."""
    a, b = np.asarray(a), np.asarray(b)
    return a.shape == b.shape and bool(np.abs(a - b).max() <= relative * np.abs(b).max())


# --- each function against its plain form ---


@pytest.mark.parametrize("jitter", [0.0, 0.001])
def test_extract_surfels(jitter: float) -> None:
    sweep = image(1, jitter)
    found, beams = extract_surfels(sweep), Beams.of(sweep)
    plain_beams = reference.scan_arrays.Beams(beams.directions, beams.lever, beams.spacing)
    swept = reference.extract_surfels.Swept(
        np.array(sweep.ranges), np.array(sweep.yaws), sweep.codes, plain_beams
    )
    plain = reference.extract_surfels.extract_surfels(
        swept, np.zeros((0, 0), bool), np.full(4, math.nan)
    )
    assert np.mean((found.index >= 0) != (plain.row_of >= 0)) < 1e-4
    both = (found.index >= 0) & (plain.row_of >= 0)
    differ = np.abs(found.rows[found.index[both]] - plain.rows[plain.row_of[both]])[:, :6]
    # A window that fits but for rounding makes another surfel of one in many thousands.
    assert np.mean(differ.max(axis=1) > 1e-5) < 1e-4
    yaws = found.yaws[found.index[both]] - plain.yaws[plain.row_of[both]]
    assert np.abs(yaws).max() < 1e-12
    assert found.noise.values == pytest.approx(plain.noise, rel=1e-6)
    ratio = found.rows[found.index[both], 7] / plain.rows[plain.row_of[both], 7]
    assert np.mean(np.abs(ratio - 1.0) > 1e-5) < 2e-4
    assert found.line_spacing == pytest.approx(plain.line_spacing, rel=1e-12)
    assert np.array_equal(found.valid, plain.valid)


@pytest.mark.parametrize("jitter", [0.0, 0.001])
@pytest.mark.parametrize("every", [1, 3])
def test_noise(jitter: float, every: int) -> None:
    """All lines, and every third: fewer than are thinned out."""
    sweep = image(1, jitter)
    lines = np.s_[::every]
    sweep = replace(
        sweep, stamps=sweep.stamps[lines], yaws=sweep.yaws[lines], ranges=sweep.ranges[lines],
        codes=sweep.codes[lines],
    )  # fmt: skip
    valid = np.isfinite(sweep.ranges)
    plain = reference.scan_noise.estimate_noise(sweep.ranges, sweep.yaws, valid)
    assert estimate_noise(sweep, valid).values == pytest.approx(plain, rel=1e-8)
    assert plain[2] > 0


def test_noise_of_lines_with_elevations_of_their_own() -> None:
    sweep = uneven(image(1))
    valid, rays = np.isfinite(sweep.ranges), Beams.of(sweep).directions
    plain = reference.scan_noise.estimate_noise(sweep.ranges, sweep.yaws, valid, rays)
    assert estimate_noise(sweep, valid).values == pytest.approx(plain, rel=1e-8)


def test_noise_of_few_readings_is_the_usual() -> None:
    sweep = image(1)
    few = np.isfinite(sweep.ranges) & (np.arange(sweep.ranges.size) < 4000).reshape(
        sweep.ranges.shape
    )
    plain = reference.scan_noise.estimate_noise(sweep.ranges, sweep.yaws, few)
    assert np.array_equal(estimate_noise(sweep, few).values, plain)
    assert plain.tolist() == [0.004, 0.0009, 0.0, 1.0]


def test_valid_readings() -> None:
    ranges = np.tile([1.0, 0.0, -1.0, math.nan, math.inf, 0.02, 3.9], 31)
    codes = np.where(np.arange(len(ranges)) % 5 == 0, 0, VALID)
    valid = np.empty(len(ranges), np.bool_)
    count = engine.mark_valid(ranges, codes, len(ranges), valid)
    plain = (codes == VALID) & (ranges > 0) & np.isfinite(ranges)
    assert np.array_equal(valid, plain)
    assert count == np.count_nonzero(plain)


def test_samples() -> None:
    grid = grids()[0]
    for stride in (1, 2, 3, 8):
        own, plain = grid.sample(stride), plain_sample(grid, stride)
        assert np.array_equal(own.rows, plain.rows)
        assert np.array_equal(own.yaws, plain.yaws)
        assert np.array_equal(own.lines, plain.lines)


def test_known_rays() -> None:
    grid = extract_surfels(synthetic.observe(FIRST, room=False).image)
    assert np.array_equal(grid.ray_states, reference.surfels.knowledge(grid.index, grid.valid))
    assert set(np.unique(grid.ray_states)) == {0, 1, 2}


def test_edges() -> None:
    assert sum(len(grid.edge_rows) for grid in grids()) > 8
    known = grids()[1].noise
    for grid in (*grids(), extract_surfels(uneven(image(1)), noise=known)):
        beams = Beams.of(grid.image)
        plain = reference.edges.edge_rows(
            grid.image.ranges, grid.image.yaws, beams.directions, beams.lever, grid.rows,
            grid.index, grid.valid, grid.noise.yaw_sigma,
        )  # fmt: skip
        assert len(plain) >= 4
        assert near(grid.edge_rows, plain, 1e-9)
    assert len(np.unique(np.round(plain[:, 4] / np.sum(plain[:, :2] ** 2, axis=1), 12))) > 1


def test_edge_equations() -> None:
    target, source = (Edges.of(grid.edge_rows) for grid in grids())
    T = MOVE.matrix()
    own = linearise_edges(target, source, T, 0.05, 2.0)
    plain = reference.edges.edge_sums(target.rows, source.rows, T, 0.05, 2.0)
    assert np.abs(plain[0]).max() > 0
    assert all(near(a, b) for a, b in zip(own, plain, strict=True))


def test_tables_and_lookup() -> None:
    grid = grids()[0]
    projection, plain = grid.projection, plain_projection(grid)
    centres = reference.projection._centres()
    lines = reference.projection.nearest(projection.middles, grid.line_spacing, centres)
    assert np.mean(projection.lines != lines) < 1e-3  # a cell's centre may fall on the border
    points = grids()[1].rows[:, :3] + [0.01, -0.3, 0.0]
    points = points[points[:, 2] > 0.03]  # of the floor, the other sweep sees another part
    seen = grid.index.reshape(-1) >= 0
    own = projection.lookup(points, seen)
    assert np.array_equal(own, reference.projection.lookup(plain, points, seen))
    assert np.mean(own >= 0) > 0.5


def test_normal_equations() -> None:
    target, source = grids()
    T = displace(MOVE.matrix(), np.array([0.004, -0.003, 0.002, 0.001, -0.002, 0.01]))
    own = linearise(target, source, 2, T, 0.003, Gate(0.05, 2.0))
    plain = reference.point_to_plane.normal_equations(
        plain_target(target), plain_sample(source, 2), T, 0.003,
        reference.point_to_plane.Gate(0.05, 2.0), plain_noise(target, source), (0, 1, 2, 3, 4, 5),
    )  # fmt: skip
    assert own.pairs == plain.pairs > 1000
    assert own.square == pytest.approx(plain.square)
    assert near(own.spurious, plain.spurious)
    for name in ("information", "lost", "gradient"):
        assert near(getattr(own, name), getattr(plain, name)), name


def plain_align(problem: Problem, init: FloatArray) -> reference.gauss_newton.RunResult:
    """Return what the plain form makes of a problem."""
    target, source = problem.target, problem.source
    sigma = max(grid.noise.yaw_scale_sigma for grid in (target, source))
    prior = problem.prior or PosePrior(np.eye(4), np.eye(6))
    covariance = prior.covariance if problem.prior else np.zeros((6, 6))
    wanted = (2 * problem.stride, problem.stride, problem.last_stride)
    strides = [source.sample(stride).stride for stride in wanted]
    scans = reference.gauss_newton.Scans(
        plain_target(target), *(plain_sample(source, stride) for stride in strides),
        target.edge_rows, source.edge_rows, plain_noise(target, source),
        reference.pose_prior.Moments(*problem.moments),
    )  # fmt: skip
    known = 1 / sigma**2 if sigma else math.inf
    plain_prior = reference.gauss_newton.Prior(prior.T, covariance, problem.dims, known)
    criteria = reference.gauss_newton.Criteria()
    return reference.gauss_newton.descend(scans, plain_prior, criteria, init[None])[1]


def assert_same(own: RunResult, plain: reference.gauss_newton.RunResult) -> None:
    """Assert that the engine's result is that of the plain form."""
    assert (own.iterations, own.settled, own.overlap) == (plain.iterations, True, True)
    assert own.pairs == plain.solution.pairs
    assert np.abs(own.T - plain.state.T).max() < 1e-9
    assert own.yaw_scale == pytest.approx(plain.state.scale, abs=1e-9)
    assert near(own.covariance, plain.knowledge.covariance, 1e-7)
    assert near(own.information, plain.knowledge.information, 1e-7)
    assert own.predicted_rmse == pytest.approx(plain.knowledge.predicted_rmse, rel=1e-7)
    assert own.degenerate.shape == plain.knowledge.degenerate.shape
    assert own.spread == pytest.approx(plain.solution.spread, rel=1e-7, nan_ok=True)


@pytest.mark.parametrize("dof", ["planar", "se3"])
@pytest.mark.parametrize("yaw_scale", [0.0, 0.01])
@pytest.mark.parametrize("bias", [0.0, 0.002])
def test_the_iteration(dof: str, yaw_scale: float, bias: float) -> None:
    """Without a bias the errors that readings share are left to a factor, else estimated."""
    target, source = grids(yaw_scale, bias)
    guess = displace(MOVE.matrix(), np.array([0.01, -0.02, 0.0, 0.0, 0.0, 0.02]))
    prior = PosePrior(read_only(guess), PosePrior.planar(MOVE, 0.02, 0.035).covariance)
    problem = Problem(target, source, prior, dof)  # type: ignore[arg-type]
    assert_same(align(problem, guess), plain_align(problem, guess))


@cache
def wall() -> tuple[SurfelGrid, SurfelGrid]:
    """Two sweeps of one wall: a slide along it is degenerate."""
    boxes = (synthetic.Box((1.0, -5.0, 0.0), (1.5, 5.0, 2.0)),)
    made, rng = [], np.random.default_rng(3)
    for y in (0.15, -0.15):
        taken = synthetic.observe(Pose2(0.0, y), boxes, room=False, sigma=SIGMA, rng=rng).image
        # No line on the border of two patches, where rounding decides.
        taken = replace(taken, yaws=read_only(taken.yaws + 0.001))
        keep = np.nan_to_num(taken.points[..., 2]) > 0.03
        noise = ScanNoise(
            SIGMA, 0.0, 0.001, yaw_scale_sigma=0.01, bias_sigma=0.002, linearity_sigma=0.004,
            offset_sigma=0.003,
        )  # fmt: skip
        made.append(extract_surfels(taken, keep=keep, noise=noise))
    return made[0], made[1]


@pytest.mark.parametrize("dof", ["planar", "se3"])
def test_the_iteration_on_a_wall(dof: str) -> None:
    prior = PosePrior.planar(Pose2(0.0, -0.30), 0.02, 0.035)
    guess = Pose2(0.01, -0.28, 0.01).matrix()
    problem = Problem(*wall(), prior, dof)  # type: ignore[arg-type]
    own = align(problem, guess)
    assert len(own.degenerate) > 0
    assert_same(own, plain_align(problem, guess))


@pytest.mark.parametrize("dof", ["planar", "se3"])
@pytest.mark.parametrize("bias", [0.0, 0.002])
def test_the_iteration_on_a_floor(dof: str, bias: float) -> None:
    """Where directions are in doubt, the spurious information allows for stretched windows."""
    pair = degenerate_pairs.draw_pair("floor", 2)
    noise = ScanNoise(SIGMA, 0.0, 0.001, bias_sigma=bias, linearity_sigma=0.004, offset_sigma=0.003)
    # No line on the border of two patches, where rounding decides.
    sweeps = (
        replace(each, yaws=read_only(each.yaws + 0.001), T_base_lidar=image(1).T_base_lidar)
        for each in (pair.target, pair.source)
    )
    target, source = (extract_surfels(sweep, noise=noise) for sweep in sweeps)
    prior = PosePrior.planar(pair.init, 0.02, 0.035)
    problem = Problem(target, source, prior, dof)  # type: ignore[arg-type]
    own = align(problem, prior.T)
    assert len(own.degenerate) == 3
    assert_same(own, plain_align(problem, prior.T))


def test_the_iteration_without_prior() -> None:
    problem = Problem(*grids())
    assert_same(align(problem, MOVE.matrix()), plain_align(problem, MOVE.matrix()))


def test_the_iteration_on_errors_larger_than_assumed() -> None:
    """Patches of 15 deg of azimuth are 10 mm off by turns, which the second solution allows for."""
    target, source = grids()
    columns = np.floor(source.image.yaws / math.radians(15.0)) % 2
    ranges = source.image.ranges + 0.010 * (columns - 0.5)
    spoiled = replace(source.image, ranges=read_only(ranges))
    spoiled_source = extract_surfels(spoiled, noise=source.noise)
    prior = PosePrior.planar(MOVE, 0.02, 0.035)
    problem = Problem(target, spoiled_source, prior)
    plain = plain_align(problem, MOVE.matrix())
    usual = align(Problem(target, source, prior), MOVE.matrix())
    assert plain.knowledge.predicted_rmse > 1.3 * usual.predicted_rmse
    assert_same(align(problem, MOVE.matrix()), plain)


def test_the_iteration_on_a_single_patch() -> None:
    """A window of the front of one box, 11 deg wide."""
    target, whole = grids()
    points = whole.image.points
    with np.errstate(invalid="ignore"):
        keep = np.abs(np.arctan2(points[..., 1], points[..., 0]) + math.radians(7.5)) < 0.1
        keep &= np.abs(points[..., 2] - 0.25) < 0.04
    source = extract_surfels(whole.image, keep=keep, noise=whole.noise)
    directions = reference.shared_errors.rays(source.rows[:, :3], 0.05, 0.3)[1]
    assert len(np.unique(reference.shared_errors.places(directions)[0])) == 1
    problem = Problem(target, source, PosePrior.planar(MOVE, 0.02, 0.035))
    assert_same(align(problem, MOVE.matrix()), plain_align(problem, MOVE.matrix()))


def test_starts_that_meet_are_one() -> None:
    target, source = grids()
    prior = PosePrior.planar(MOVE, 0.02, 0.035)
    problem = Problem(target, source, prior)
    starts = spread_starts(problem, prior.T, 8)
    ends, last = follow_starts(problem, problem.make_source(), Criteria(), starts)
    assert len(ends) == 1
    assert np.abs(ends[0] - last.T).max() < 0.01


def test_violations() -> None:
    wall = (synthetic.Box((3.2, -6.0, 0.0), (3.4, 6.0, 2.5)),)
    far, near = (
        extract_surfels(synthetic.observe(Pose2(x), wall, room=False, width=2.0).image)
        for x in (0.0, 1.0)
    )
    for target, source, move in ((*grids(), MOVE), (far, near, Pose2(1.0)), (near, far, Pose2(-1))):
        own = _sum_violations(target, source.sample(4), move.matrix())
        plain = reference.free_space.violations(
            plain_target(target), target.ray_states, 4.0, source.sample(4).rows, move.matrix()
        )
        assert target.image.spec.max_range == 4.0
        assert own[1] == plain[1] > 100
        assert own[0] == pytest.approx(plain[0])
    assert np.count_nonzero(far.ray_states == EMPTY_RAY) > 1000


def test_contradicted_share() -> None:
    target, source = grids()
    for shift, least, most in ((0.0, 0.0, 0.01), (-0.03, 0.1, 1.0), (0.03, 0.1, 1.0)):
        T = (Pose2(shift) @ MOVE).matrix()
        own = find_contradicted_share(target, source, T, 4)
        plain = [
            reference.free_space.share_in_front(plain_target(a), b.sample(4).rows, pose)
            for a, b, pose in ((target, source, T), (source, target, np.linalg.inv(T)))
        ]
        assert own == pytest.approx(max(plain))
        assert least <= own <= most
    away = Pose2(0.0, 0.0, math.pi).matrix()
    assert find_contradicted_share(target, source, away, 4) == 0.0


def test_algebra() -> None:
    rng = np.random.default_rng(0)
    for k in (3, 6):
        for _ in range(20):
            half = rng.normal(size=(k, k))
            H, noise = half @ half.T, np.diag(rng.uniform(0, 0.2, k))
            own = find_determined(H, noise, 1.3)
            plain = reference.algebra.determined(H, noise, 1.3)
            assert near(own[0], plain[0])
            assert near(own[1], plain[1])
            assert len(own[2]) == len(plain[2])
            assert near(invert_information(H), np.linalg.inv(H), 1e-7)
    flat = np.diag([4.0, 0.0, 1.0])
    assert invert_information(flat) == pytest.approx(np.diag([0.25, 0.0, 1.0]))


@pytest.mark.parametrize("known", [2.0, 1e6, math.inf])
def test_a_nuisance_is_marginalised_by_its_schur_complement(known: float) -> None:
    half = np.random.default_rng(0).normal(size=(7, 7))
    H = half @ half.T
    whole = H + np.diag([0.0] * 6 + [0.0 if math.isinf(known) else known])
    expected = H[:6, :6] if math.isinf(known) else np.linalg.inv(np.linalg.inv(whole)[:6, :6])
    assert near(marginalise(H, known), expected, 1e-8)


def test_small_motions() -> None:
    rng = np.random.default_rng(0)
    for step in rng.normal(size=(20, 6)) * 0.4:
        T = displace(np.eye(4), rng.normal(size=6))
        moved = displace(T, step)
        assert np.array_equal(displace(T, np.stack([-step, step]))[1], moved)
        assert moved == pytest.approx(reference.pose_prior.displaced(T, step), abs=1e-14)
        assert deviation(moved, T) == pytest.approx(step, abs=1e-12)
    assert deviation(T, T) == pytest.approx(np.zeros(6), abs=1e-15)
    points, half = rng.normal(size=(50, 3)), rng.normal(size=(6, 6))
    assert predict_rmse(points, half @ half.T) == pytest.approx(
        reference.pose_prior.displacement(reference.pose_prior.Moments.of(points), half @ half.T)
    )


def test_nearest_neighbours_are_those_of_a_full_search() -> None:
    rng = np.random.default_rng(0)
    points = np.round(rng.normal(size=(500, 3)), 2)  # with ties
    points[100:120] = points[0]
    wanted = rng.normal(size=(60, 3))
    squares, indices = Tree.of(points).nearest(wanted, 20)
    every = np.sum((wanted[:, None] - points) ** 2, axis=2)
    assert squares == pytest.approx(np.sort(every, axis=1)[:, :20], abs=1e-15)
    assert np.take_along_axis(every, indices.astype(int), 1) == pytest.approx(squares, abs=1e-15)
    few = Tree.of(points[:3]).nearest(wanted, 5)
    assert np.isinf(few[0][:, 3:]).all()
    assert (few[1][:, 3:] == -1).all()


@pytest.mark.parametrize("within", [np.inf, 0.3])
@pytest.mark.parametrize("size", [(400, 3), (400, 2), (1, 3), (0, 3)])
def test_the_closest_point_of_a_tree_is_that_of_all_points(
    size: tuple[int, int], within: float
) -> None:
    rng = np.random.default_rng(0)
    points, wanted = rng.normal(size=size), 1.5 * rng.normal(size=(200, size[1]))
    distances, indices = Tree.of(points).closest(wanted, within)
    every = np.linalg.norm(wanted[:, None] - points, axis=2)
    least = np.min(every, axis=1, initial=np.inf)
    near = least < within
    assert np.where(near, least, np.inf) == pytest.approx(distances, abs=1e-15)
    assert np.all(indices[~near] == len(points))
    assert every[near, indices[near]] == pytest.approx(least[near], abs=1e-15)
    assert np.array_equal(Tree.of(points).is_near(wanted, 0.3), least <= 0.3)


@pytest.mark.parametrize("k", [0, 65])
def test_more_neighbours_than_there_is_room_for_are_refused(k: int) -> None:
    tree = Tree.of(np.zeros((100, 3)))
    with pytest.raises(ConfigError, match="1 to 64"):
        tree.nearest(np.zeros((1, 3)), k)
    with pytest.raises(ConfigError, match="1 to 64"):
        tree.fit_planes(k)


def test_planes_of_a_tree_are_those_of_its_neighbours() -> None:
    points = np.random.default_rng(0).normal(size=(300, 3))
    centroids, normals, variances = Tree.of(points).fit_planes(20)
    nearest = np.argsort(np.sum((points[:, None] - points) ** 2, axis=2), axis=1)[:, :20]
    around = points[nearest] - points[nearest].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / 20)
    assert centroids == pytest.approx(points[nearest].mean(axis=1), abs=1e-12)
    assert np.abs(np.sum(normals * vectors[..., 0], axis=1)) == pytest.approx(1.0, abs=1e-6)
    assert variances == pytest.approx(values[:, :2])


def test_patches_are_planes_through_the_cells_within_their_window() -> None:
    points = np.random.default_rng(0).normal(size=(3000, 3)) * (1.0, 1.0, 0.05) + (0.0, 0.0, 3.0)
    cloud = prepare_cloud(points)
    level = cloud.levels[2]
    cells = np.floor(points / level.side).astype(int)
    _, numbers = np.unique(cells, axis=0, return_inverse=True)
    count = np.bincount(numbers.ravel())
    assert np.sort(count) == pytest.approx(np.sort(level.counts))
    centres = np.stack([np.bincount(numbers.ravel(), x) / count for x in points.T], axis=1)
    found = {tuple(np.round(p[:3], 6)): p for p in level.patches}
    matched = 0
    for centre in centres:
        inside = np.linalg.norm(centres - centre, axis=1) < WINDOW_RADII[0] * level.side
        window = points[inside[numbers.ravel()]]
        patch = found.get(tuple(np.round(window.mean(axis=0), 6)))
        if patch is None or patch[9] != len(window):
            continue  # its window had to grow
        values, vectors = np.linalg.eigh(np.cov(window.T, bias=True))
        wanted = values * (len(window) / max(len(window) - 3, 1), 1.0, 1.0)
        if len(window) >= 10 and level.flat[np.all(level.patches == patch, axis=1)].all():
            assert patch[6:9] == pytest.approx(wanted, rel=1e-6, abs=1e-12)
            assert abs(patch[3:6] @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-6)
            matched += 1
    assert matched > 20


def test_pairs_are_the_nearest_patches_with_a_like_normal() -> None:
    rng = np.random.default_rng(1)
    patches = rng.uniform(0.5, 1.0, size=(200, 10))
    patches[:, 3:6] = rng.normal(size=(200, 3))
    patches[:, 3:6] /= np.linalg.norm(patches[:, 3:6], axis=1, keepdims=True)
    targets, sources = np.ascontiguousarray(patches[:150]), np.ascontiguousarray(patches[150:])
    tree = Tree.of(np.ascontiguousarray(targets[:, :3]))
    pairs, indices = np.empty((50, PAIR)), np.empty((50, 2), np.int32)
    T = MOVE.matrix()
    k = engine.pair_patches(
        tree.points, tree.order, tree.axes, 150, targets, sources, 50, T, 0.4, 0.7, pairs, indices
    )
    a, n = sources[:, :3] @ T[:3, :3].T, sources[:, 3:6] @ T[:3, :3].T
    moved = a + T[:3, 3]
    apart = np.linalg.norm(moved[:, None] - targets[:, :3], axis=2)
    apart[n @ targets[:, 3:6].T < 0.7] = np.inf
    best = np.argmin(apart, axis=1)
    near = np.flatnonzero(apart[np.arange(50), best] < 0.4)
    assert 10 < k == len(near)
    assert np.array_equal(indices[:k], np.stack([near, best[near]], axis=1))

    # Residual, Jacobians and variances.
    q, m = targets[best[near], :3], targets[best[near], 3:6]
    mean, half = n[near] + m, (n[near] - m) / 2
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    e = np.sum(mean * (moved[near] - q), axis=1)
    square = apart[near, best[near]] ** 2
    assert pairs[:k, 12] == pytest.approx(e)
    assert pairs[:k, :6] == pytest.approx(np.hstack([mean, np.cross(a[near], mean)]))
    assert pairs[:k, 6:12] == pytest.approx(np.hstack([half, np.cross(a[near], half)]))
    for column, rows in ((13, sources[near]), (14, targets[best[near]])):
        variance = rows[:, 6] / rows[:, 9] * (1 + square / (4 * rows[:, 7]))
        assert pairs[:k, column] == pytest.approx(variance)


@pytest.mark.parametrize("within", [0.01, 0.2, 10.0])
def test_what_is_near_is_what_a_full_search_finds(within: float) -> None:
    rng = np.random.default_rng(0)
    points, places = rng.normal(size=(300, 3)), rng.normal(size=(200, 3))
    places[:20] = points[:20] + 0.005
    near = is_near(places, points, within)
    assert np.array_equal(near, reference.readings.is_near(places, points, within))
    assert near.any()
    assert not is_near(places, points[:0], within).any()


def readings(seed: int, own: bool = False) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ranges that step and have gaps, elevations (each line's own or common) and yaws."""
    rng = np.random.default_rng(seed)
    ranges = np.cumsum(rng.normal(0.0, 0.05, (40, 30)), axis=1) + 2.0
    ranges[rng.random(ranges.shape) < 0.3] = math.nan
    elevations = np.linspace(-1.0, 0.7, 30)
    yaws = np.linspace(0.5, -0.5, 40)[:, None] + rng.normal(0.0, 0.001, (40, 30))
    if own:
        elevations = elevations + np.sort(rng.uniform(-0.02, 0.02, (40, 30)), axis=1)
    return ranges, elevations, yaws


@pytest.mark.parametrize("own", [False, True])
def test_mixed_pixels(own: bool) -> None:
    for seed in range(5):
        given = readings(seed, own)
        found = np.zeros(given[0].shape, dtype=bool)
        ranges, elevations, yaws = given
        own = elevations.ndim > 1
        engine.mark_mixed_pixels(ranges, elevations, own, yaws, *found.shape, 0.04, 0.3, found)
        assert found.any()
        assert np.array_equal(found, reference.readings.mixed(*given, 0.04, 0.3))


@pytest.mark.parametrize("own", [False, True])
def test_gaps(own: bool) -> None:
    for seed in range(5):
        given = readings(seed, own)
        ranges, (_, elevations, yaws) = given[0].copy(), given
        engine.fill_gaps(ranges, elevations, own, yaws, *ranges.shape, 0.15, 0.1)
        wanted = reference.readings.filled(*given, 0.15, 0.1)
        assert np.isfinite(ranges).sum() > np.isfinite(given[0]).sum()
        assert np.array_equal(ranges, wanted, equal_nan=True)


@pytest.mark.parametrize("own", [False, True])
def test_neighbours_on_a_surface(own: bool) -> None:
    ranges, elevations, yaws = readings(0, own)
    lines, beams = (np.ascontiguousarray(part) for part in np.nonzero(np.isfinite(ranges)))
    counts, n = np.empty(len(lines), dtype=np.int64), len(lines)
    engine.count_neighbours(
        ranges, yaws, elevations, own, *ranges.shape, lines, beams, n, 0.04, 0.3, counts
    )  # fmt: skip
    wanted = reference.readings.neighbours(ranges, elevations, yaws, 0.04, 0.3)
    assert len(np.unique(counts)) > 5
    assert np.array_equal(counts, wanted[lines, beams])


def uneven(sweep: RangeImage) -> RangeImage:
    """Every other line half a beam higher, each beam off by up to a quarter, lines repeated."""
    rng = np.random.default_rng(9)
    off = (
        rng.uniform(-0.25, 0.25, sweep.ranges.shape) + 0.5 * (np.arange(sweep.n_lines) % 2)[:, None]
    )
    lines = np.sort(rng.choice(sweep.n_lines, sweep.n_lines))
    yaws, ranges, codes = (each[lines] for each in (sweep.yaws, sweep.ranges, sweep.codes))
    return replace(
        sweep, yaws=read_only(yaws), ranges=read_only(ranges), codes=read_only(codes, np.int64),
        elevations=read_only(sweep.spec.elevations + math.tau / 1024 * off),
    )  # fmt: skip


def shift_lines(sweep: RangeImage) -> RangeImage:
    """Every other line half a beam higher, every tenth beam missing in a third of the lines."""
    shift = math.pi / 1024 * (np.arange(sweep.n_lines) % 2)
    codes = np.array(sweep.codes)
    codes[::3, ::10] = UNMEASURED
    return replace(
        sweep,
        ranges=read_only(np.where(codes == UNMEASURED, math.nan, sweep.ranges)),
        codes=read_only(codes, np.int64),
        elevations=read_only(sweep.spec.elevations + shift[:, None]),
    )


def test_placed_readings() -> None:
    sweep = image(1)
    leaning = replace(
        sweep, T_base_lidar=apply_mount(sweep.T_base_lidar, MountConfig(0.01, 0.02, 0.1))
    )
    for seen in (sweep, leaning, shift_lines(sweep)):
        wanted = seen.ranges < 3.0
        for found, plain in zip(
            SweepPoints.of(seen, wanted), reference.readings.placed(seen, wanted), strict=True
        ):
            assert len(found) > 1000
            assert np.array_equal(found, plain)


def test_free_reach() -> None:
    rng = np.random.default_rng(0)
    distance, kinds = rng.uniform(0.1, 3.0, (50, 25)), rng.choice([0, 1, 1, 1, 2], (50, 25))
    kinds[:, -3:][rng.random((50, 3)) < 0.9] = 1
    kinds[kinds == 2] *= rng.random((kinds == 2).sum()) < 0.1
    lines, reach = np.repeat(np.arange(50), 25), np.empty(50)
    assert not engine.measure_free_reach(
        lines, distance.ravel(), kinds.ravel().astype(np.uint8), 1250, 50, 0.2, 0.45, 0.05, reach
    )
    floor, solid = (np.where(kinds == kind, distance, np.inf) for kind in (1, 2))
    assert len(np.unique(reach)) > 10
    assert np.array_equal(reach, reference.readings.free_reach(floor, solid, 0.2, 0.45, 0.05))


@pytest.mark.parametrize(
    ("first", "last"),
    [(0.6, -0.5), (math.pi, -math.pi), (3.5, -2.6), (7.0, 5.9)],
    ids=["a sweep", "a full turn", "more than half a turn to the left", "after a full turn"],
)
def test_floor(first: float, last: float) -> None:
    rng = np.random.default_rng(0)
    cells, origin, pose = rng.integers(0, 4, (90, 70)), np.array([-1.0, 2.0]), Pose2(1.2, 3.6, 2.9)
    yaws = np.linspace(first, last, 60) + rng.uniform(-0.001, 0.001, 60)
    reach, points = rng.uniform(-0.05, 2.5, 60), rng.uniform(-3.0, 3.0, (50, 2))
    wanted = reference.floor.mark_floor(cells, origin, pose, yaws, reach, points)
    marked = cells.copy()
    place = np.array([pose.x, pose.y, math.cos(pose.yaw), math.sin(pose.yaw)])
    assert not engine.mark_floor(
        marked, *cells.shape, origin, RESOLUTION, place, yaws, reach, 60, points, 50
    )
    assert np.count_nonzero(marked != cells) > 100
    assert np.array_equal(marked, wanted)


def test_a_sweep_without_lines_shows_no_floor() -> None:
    cells, none = np.zeros((5, 4), np.int64), np.empty(0)
    assert not engine.mark_floor(
        cells, 5, 4, np.zeros(2), RESOLUTION, np.eye(4)[2], none, none, 0, none, 0
    )
    assert not cells.any()


def test_rays_that_meet_planes() -> None:
    rng, sweep = np.random.default_rng(0), image(1)
    for seen in (sweep, shift_lines(sweep)):
        met = rng.random(seen.ranges.shape) < 0.3
        n = np.count_nonzero(met)
        normals, offsets = rng.standard_normal((n, 3)), rng.uniform(0.5, 2.0, n)
        ranges, rays = np.full(met.shape, np.nan), _list_rays(seen, met)
        engine.meet_planes(*rays, normals, offsets, ranges)
        plain = reference.readings.meet_planes(seen, met, normals, offsets)
        assert n > 1000
        assert np.array_equal(ranges, plain, equal_nan=True)

        points = rng.uniform(-1.0, 1.0, (n, 3))
        near, limits = np.empty(n, dtype=bool), rng.uniform(0.0, 2.0, n)
        engine.find_near_points(*rays, ranges, points, limits, near)
        assert 0.1 < near.mean() < 0.9
        assert np.array_equal(
            near, reference.readings.near_points(seen, met, ranges, points, limits)
        )


def test_hidden_faces() -> None:
    rng = np.random.default_rng(0)
    surface, origin, side = rng.random((3, 60, 50)) < 0.01, np.array([-0.3, 0.2]), 0.015
    points, normals = rng.uniform(-0.4, 0.8, (200, 2)), rng.standard_normal((200, 2))
    slices, place, steps = rng.integers(0, 3, 200), np.array([1.0, 0.1]), np.arange(side, 2, side)
    hidden = np.empty(200, dtype=bool)
    engine.find_hidden(
        surface, 60, 50, origin, origin + side * np.array([60, 50]), side, points, normals, slices,
        200, place, steps, len(steps), hidden,
    )  # fmt: skip
    plain = reference.floor.find_hidden(
        surface, origin, side, points, normals, slices, place, steps
    )
    assert 10 < np.count_nonzero(hidden) < 190
    assert np.array_equal(hidden, plain)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.4, 1.0])
def test_grids(share: float) -> None:
    grid = np.random.default_rng(0).random((40, 30)) < share
    assert np.array_equal(label_cells(grid), reference.grids.label_cells(grid))
    for radius in (-1.0, 0.0, 1.5, 4.0, 100.0):
        assert np.array_equal(dilate(grid, radius), reference.grids.dilate(grid, radius))


def test_pieces() -> None:
    for seed in range(5):
        ranges, rng = readings(seed)[0], np.random.default_rng(seed)
        there = np.isfinite(ranges) & (rng.random(ranges.shape) < 0.9)
        lines, beams = (np.ascontiguousarray(part) for part in np.nonzero(there))
        sizes = np.empty(len(lines), dtype=np.int64)
        assert not engine.measure_components(
            ranges, *ranges.shape, lines, beams, len(lines), 0.05, sizes
        )
        assert len(np.unique(sizes)) > 5
        assert np.array_equal(sizes, reference.grids.piece_sizes(ranges, there, 0.05))


# --- lines and beams that are on no grid ---


def test_each_line_may_have_rays_of_its_own() -> None:
    """Every other line half a beam higher: as many surfels, as near to the surfaces."""
    wall = (synthetic.Box((1.0, -3.0, 0.0), (1.5, 3.0, 2.0)),)
    lower = synthetic.observe(Pose2(), wall, room=False).image
    shifted = replace(
        lower,
        spec=replace(lower.spec, elevations=read_only(lower.spec.elevations + math.pi / 1024)),
    )
    rays = np.stack([Beams.of(lower).directions, Beams.of(shifted).directions])
    odd = np.arange(lower.n_lines) % 2
    rays = np.ascontiguousarray(rays[odd])
    turned = np.cos(lower.yaws)[..., None] * rays[..., :1]  # x of each ray in the scan's frame
    with np.errstate(divide="ignore"):
        ranges = np.ascontiguousarray((1.0 - 0.05 * np.cos(lower.yaws)) / turned[..., 0])
    up = np.abs(0.3 + ranges * rays[..., 2] - 1.0) < 0.8
    valid = np.ascontiguousarray((ranges > 0) & (ranges < 4.0) & up)
    sweep = native.Sweep(
        n_lines=lower.n_lines, n_beams=lower.spec.n_beams, stride=lower.spec.n_beams,
        ranges=ranges, yaws=lower.yaws, rays=rays, ray_stride=3 * lower.spec.n_beams,
        lever=Beams.of(lower).lever, beam_spacing=Beams.of(lower).spacing,
    )  # fmt: skip
    windows = np.array([[4, 6], [1, 1]], dtype=np.int64)
    rows, _, index = fit_surfels(sweep, valid, valid, np.array([0.004, 0.0, 0.0, 1.0]), windows)
    assert np.count_nonzero(index >= 0) == len(rows) > 0.95 * np.count_nonzero(valid)
    assert np.abs(rows[:, 0] - 1.0).max() < 1e-6
    assert np.abs(rows[:, 3] + 1.0).max() < 1e-6


def test_the_noise_of_each_reading_can_be_handed_in() -> None:
    grid = extract_surfels(image(1), noise=ScanNoise(SIGMA, 0.0))
    sweep = make_native_sweep(grid.image)
    sigmas = np.full(grid.image.ranges.shape, 2 * SIGMA)
    sweep.sigmas = Doubles.from_param(sigmas)
    windows = np.array([[4, 6], [1, 1]], dtype=np.int64)
    noise = np.array([SIGMA, 0.0, 0.0, 1.0])
    own, _, index = fit_surfels(sweep, grid.valid, grid.valid, noise, windows)
    usual = fit_surfels(make_native_sweep(grid.image), grid.valid, grid.valid, noise, windows)
    both = (index >= 0) & (usual[2] >= 0)
    ratio = own[index[both], 6] / usual[0][usual[2][both], 6]
    assert np.median(ratio) == pytest.approx(4.0, rel=0.01)


# --- levels and builds ---


def fingerprint() -> tuple[bytes, ...]:
    """Return the bytes of what a registration and its parts come to."""
    target, source = (extract_surfels(image(seed, 0.001)) for seed in (1, 2))
    shared = {"bias_sigma": 0.002, "linearity_sigma": 0.004, "offset_sigma": 0.003}
    pair = [replace(grid, noise=replace(grid.noise, **shared)) for grid in (target, source)]
    prior = PosePrior.planar(MOVE, 0.02, 0.035)
    result = align(Problem(target, source, prior, "se3"), prior.T)
    planar = align(Problem(*pair, prior), prior.T)
    cloud = prepare_cloud(target.rows[:2000, :3]).levels[0]
    parts = (
        target.rows, target.index, target.edge_rows, target.ray_states, target.projection.lines,
        target.noise.values, result.T, result.covariance, result.information, planar.T,
        planar.covariance, cloud.patches, cloud.flat,
    )  # fmt: skip
    return tuple(np.ascontiguousarray(part).tobytes() for part in parts)


def run_by(other: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let another library or level do all the work."""
    for name in native.FUNCTIONS:
        monkeypatch.setattr(engine, name, getattr(other, name), raising=False)


def test_all_levels_of_the_processor_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = [level for level in (1, 3, 4) if level <= engine.level]
    found = []
    for level in levels:
        run_by(Engine(level=level), monkeypatch)
        found.append(fingerprint())
    assert all(each == found[0] for each in found)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_another_build_gives_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without optimisation every operation is carried out as it is written."""
    library, digest = tmp_path / "libengine.so.1", native.digest_sources()
    flags = ["-std=gnu11", "-O0", "-fPIC", "-shared", "-ffp-contract=off", "-Wno-psabi"]
    sources = [str(NATIVE / "engine.c"), str(NATIVE / "levels.c")]
    defined = ["-DLEVEL=v1", f'-DDIGEST="{digest}"']
    subprocess.run(
        ["gcc", *flags, *defined, *sources, "-o", str(library), "-lm"], check=True, timeout=100
    )
    expected = fingerprint()
    run_by(Engine(library, level=1), monkeypatch)
    assert fingerprint() == expected


# --- the border ---


def test_both_sides_agree_on_the_values() -> None:
    sizes = np.empty(len(native.VALUES), dtype=np.int64)
    engine.write_struct_sizes(sizes)
    assert sizes.tolist() == [ctypes.sizeof(each) for each in native.VALUES]


def test_the_address_of_an_array_is_that_of_its_first_number() -> None:
    numbers = np.arange(12.0).reshape(3, 4)
    for array in (numbers, numbers[1:], read_only(numbers), np.zeros(0), np.zeros(3, np.bool_)):
        assert address_of(array) == array.ctypes.data


def test_arrays_of_another_type_or_layout_are_refused() -> None:
    centres = np.zeros(16384)
    with pytest.raises(ctypes.ArgumentError, match="float64"):
        engine.write_cell_centres(centres.astype(np.float32))
    with pytest.raises(ctypes.ArgumentError, match="contiguous"):
        engine.write_cell_centres(np.zeros(2 * 16384)[::2])
    with pytest.raises(TypeError, match="int32"):
        native.Target(index=np.zeros(3))
    with pytest.raises(AttributeError, match="no function"):
        engine.warp  # noqa: B018


def test_a_library_built_from_other_sources_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when the changed file is older than the library: its content counts."""
    for path in NATIVE.glob("*.[ch]"):
        shutil.copy(path, tmp_path)
    assert native.digest_sources(tmp_path) == native.digest_sources()
    changed = tmp_path / "edges.h"
    changed.write_text(changed.read_text().replace("MIN_EDGE_COSINE 0.35", "MIN_EDGE_COSINE 0.30"))
    other = native.digest_sources(tmp_path)
    monkeypatch.setattr(native, "digest_sources", lambda: other)
    with pytest.raises(FileError, match="make setup"):
        Engine().library  # noqa: B018


def test_a_missing_library_is_one_line_with_its_cure(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="make setup") as error:
        Engine(tmp_path / "libengine.so.1").library  # noqa: B018
    assert "\n" not in str(error.value)


def test_a_wheel_without_sources_has_no_digest(tmp_path: Path) -> None:
    assert native.digest_sources(tmp_path) is None


def test_no_just_in_time_compiler_is_imported() -> None:
    code = "import sys, scan3d_twin.core.registration as r; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
