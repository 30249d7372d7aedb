"""The probe: variances known by hand, biased samplers found out, the sampler after Cycles."""

import csv
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import oracle
import pytest
from core_scenes import JIT_IS_OFF, camera, fewer, floor_scene, random_scene

from lighttree_batch import probe
from lighttree_batch.__main__ import main
from lighttree_batch.cycles_build import build_cycles_tree
from lighttree_batch.cycles_style import allocate_shares, choose_cycles_wave, expect_cycles_wave
from lighttree_batch.probe_points import contributions, surface_points
from lighttree_core import Settings
from lighttree_core.lights import NO_LIGHT, bound_lights, build_lights
from lighttree_core.rays import Tracer
from lighttree_core.scene import Lamps
from lighttree_core.vec import LUMINANCE
from lighttree_core.world import build_world

CITY = Path(__file__).parent / "scenes" / "city-tiny.npz"
COLUMNS = """
    sampler picks choose_ns cost_ns dead_share mean_lights
    rel_variance_median rel_variance_p90 rel_variance_p99 rel_variance_mean
    variance_ns_median variance_ns_mean estimate estimate_error lost unbiased
    scene points lights seed
"""
SAMPLERS = [("lighttree", 1), ("lighttree", 4), ("lighttree", 16)]
OTHERS = [("power", 1), ("uniform", 1), ("cycles-style", 1), ("oracle p ~ f", 1)]
ORIGIN, UP = np.zeros(3, np.float32), np.array([0, 0, 1], np.float32)


@pytest.fixture(autouse=True)
def short_runs(monkeypatch):
    """Fewer numbers where kernels run as plain Python."""
    if JIT_IS_OFF:
        for name, value in (("NUM_PLACES", 64), ("NUM_TIMED", 4), ("NUM_RUNS", 1)):
            monkeypatch.setattr(probe, name, value)


def open_scene(scene):
    return build_world(scene, Settings(threads=1)), Tracer(scene.vertices, scene.triangles)


def lamps_overhead():
    """Three lamps that give the origin irradiances of 1, 2 and 3, the last from below the floor."""
    lamps = Lamps.empty(3)
    lamps.names = ["A", "B", "C"]
    lamps.position[:] = [[0, 0, 2], [3, 0, 4], [0, 3, -4]]
    lamps.radiance[:] = np.array([[4], [2 * 25 / 0.8], [3 * 25 / 0.8]])
    return lamps


def test_contributions_are_those_of_the_formula_and_know_what_is_blocked():
    world, tracer = open_scene(floor_scene(lamps_overhead()))
    f, seen = contributions(world, tracer, 0.001 * UP, UP, 0)
    assert f == pytest.approx([1, 2, 0], rel=2e-3) and seen == pytest.approx(f)
    f, seen = contributions(world, tracer, 0.001 * UP, -UP, 0)
    assert f == pytest.approx([0, 0, 3], rel=2e-3) and not seen.any()


def test_contributions_of_all_kinds_of_lights_are_those_of_brute_force():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, fewer(30, 6))
    world, tracer = open_scene(scene)
    for _ in range(fewer(10, 2)):
        p = rng.uniform([-10, -10, 0.1], [10, 10, 4]).astype(np.float32)
        f, seen = contributions(world, tracer, p, UP, 0)
        expected = oracle.irradiance(scene, p, UP) @ np.array(LUMINANCE, np.float64)
        assert f.sum() == pytest.approx(expected, rel=0.02)
        assert np.all(seen <= f)


def test_variance_of_one_pick_is_known_by_hand():
    f, seen = np.array([1.0, 2.0, 4.0]), np.array([1.0, 2.0, 0.0])
    places = (np.arange(300) + 0.5) / 300
    world, _ = open_scene(floor_scene(lamps_overhead()))
    bounds = bound_lights(world.sampler.lights)

    def judge(candidate):
        return probe.judge_point(candidate, ORIGIN, UP, f, seen, places)

    by_name = {
        each.name: each
        for each in probe.list_candidates(world.sampler, bounds, (), None, 1)
        if each.num_picks == 1
    }
    # Thirds: 3 (1 + 4) - 9 = 6, over 9. By f: 7 (1 + 2) - 9 = 12, over 9.
    assert judge(by_name["uniform"])[:2] == pytest.approx((6 / 9, 1))
    assert judge(by_name["oracle p ~ f"])[0] == pytest.approx(12 / 9)
    # Power: 4, 62.5 and 93.75 of 160.25.
    shares = np.array([4, 62.5, 93.75]) / 160.25
    by_power = judge(by_name["power"])
    assert by_power[0] == pytest.approx((1 / shares[0] + 4 / shares[1]) / 9 - 1)


def test_variance_over_places_is_that_of_the_probabilities():
    rng = np.random.default_rng(7)
    scene = random_scene(rng, fewer(20, 5))
    world, tracer = open_scene(scene)
    p = np.array([1, 2, 0.5], np.float32)
    f, seen = contributions(world, tracer, p, UP, 0)
    places = (np.arange(fewer(100_000, 2000)) + 0.5) / fewer(100_000, 2000)
    candidate = next(
        probe.list_candidates(world.sampler, bound_lights(world.sampler.lights), (), None, 1)
    )
    from_probabilities = probe.judge_point(candidate, p, UP, f, seen, places)[0]
    # Called a sampler of more than one pick, it is judged over places alone; the second is unused.
    over_places = probe.judge_point(
        candidate._replace(num_picks=2, choose=partial(choose_first, candidate)),
        *(p, UP, f, seen, places),
    )[0]
    # Each light's run of places is off by one place at most.
    assert over_places == pytest.approx(from_probabilities, rel=fewer(0.02, 0.2))


def choose_first(candidate, p, n, u, light, expected):
    """One pick in place of two."""
    first, first_expected = np.empty((len(u), 1), np.int32), np.empty((len(u), 1))
    candidate.choose(p, n, u, first, first_expected)
    light[:, :1], expected[:, :1], light[:, 1:] = first, first_expected, NO_LIGHT


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "lamps.npz"
    random_scene(np.random.default_rng(7), fewer(40, 8)).save(path)
    return path


def quiet(fraction, text):
    pass


def test_every_sampler_estimates_the_exact_sum(scene_file):
    found = probe.run_probe(scene_file, fewer(50, 2), 1, ["width=2"], 0, quiet)
    assert [(row["sampler"], row["picks"]) for row in found.rows] == [
        *SAMPLERS,
        *(("width=2", num) for num in (1, 4, 16)),
        *OTHERS,
    ]
    assert all(row["unbiased"] for row in found.rows)
    one, four, sixteen, *_ = (row["rel_variance_mean"] for row in found.rows)
    assert 0 < sixteen < four < one
    assert all(row["lights"] == len(bound_lights_of(scene_file).flux) for row in found.rows)


def bound_lights_of(file):
    lights, _, _ = build_lights(probe.load_scene(file, quiet))
    return bound_lights(lights)


def test_the_same_seed_finds_the_same_variances(scene_file):
    first, again = (probe.run_probe(scene_file, 2, 3, (), threads, quiet) for threads in (1, 2))
    assert np.array_equal(first.relative_variance, again.relative_variance)


def test_a_sampler_that_is_wrong_about_its_probabilities_is_called_biased():
    world, _ = open_scene(floor_scene(lamps_overhead()))
    seen, places = np.array([1.0, 2.0, 0.0]), (np.arange(300) + 0.5) / 300
    candidates = probe.list_candidates(
        world.sampler, bound_lights(world.sampler.lights), (), None, 1
    )
    right = next(each for each in candidates if each.name == "uniform")

    def choose_wrong(p, n, u, light, expected):
        right.choose(p, n, u, light, expected)
        expected *= 1.2

    def expect_nothing(p, n, light, expected):
        right.expect(p, n, light, expected)
        expected[light == 0] = 0

    for wrong in (right._replace(choose=choose_wrong), right._replace(expect=expect_nothing)):
        judged = [
            probe.judge_point(each, ORIGIN, UP, seen, seen, places) for each in (right, wrong)
        ]
        verdicts = [
            probe.summarize(right, np.array([row]).T.repeat(50, 1), 1.0, 1.0)["unbiased"]
            for row in judged
        ]
        assert verdicts == [True, False]


def random_points(rng, num):
    for _ in range(num):
        n = rng.normal(size=3)
        p = rng.uniform([-10, -10, -1], [10, 10, 4])
        yield p.astype(np.float32), (n / np.linalg.norm(n)).astype(np.float32)


def cycles_pmfs(tree, p, n):
    pmfs = np.empty(len(tree.place))
    lights = np.arange(len(pmfs), dtype=np.int32)
    expect_cycles_wave(tree, allocate_shares(tree), tuple(p), tuple(n), lights, pmfs)
    return pmfs


@pytest.mark.parametrize("num_lamps", [1, 9, 60])
def test_the_sampler_after_cycles_chooses_as_often_as_its_probability_says(num_lamps):
    rng = np.random.default_rng(num_lamps)
    scene = random_scene(rng, fewer(num_lamps, min(num_lamps, 12)))
    world, tracer = open_scene(scene)
    tree = build_cycles_tree(world.sampler.lights, bound_lights(world.sampler.lights))
    num = fewer(20_000, 500)
    u, light, pmf = (np.arange(num) + 0.5) / num, np.empty((num, 1), np.int32), np.empty((num, 1))
    for p, n in random_points(rng, fewer(10, 2)):
        pmfs = cycles_pmfs(tree, p, n)
        assert np.all(pmfs >= 0) and pmfs.sum() <= 1 + 1e-5
        choose_cycles_wave(
            tree, allocate_shares(tree), np.tile(p, (num, 1)), np.tile(n, (num, 1)), u, light, pmf
        )
        shares = np.bincount(light[:, 0] + 1, minlength=len(pmfs) + 1) / num
        # A light's places of u lie in one run, which holds at most one place too many or too few.
        assert shares[1:] == pytest.approx(pmfs, abs=1.5 / num)
        assert shares[0] == pytest.approx(1 - pmfs.sum(), abs=(len(pmfs) + 1) / num)
        is_chosen = light[:, 0] != NO_LIGHT
        assert pmf[is_chosen, 0] == pytest.approx(pmfs[light[is_chosen, 0]], rel=1e-9)
        f, _ = contributions(world, tracer, p, n, 0)
        assert np.all(pmfs[f > 1e-6 * f.sum()] > 0)


def test_the_tree_after_cycles_bounds_every_light_once():
    lights, _, _ = build_lights(random_scene(np.random.default_rng(7), fewer(200, 20)))
    bounds = bound_lights(lights)
    tree = build_cycles_tree(lights, bounds)
    assert np.array_equal(np.sort(tree.light_id), np.flatnonzero(bounds.flux > 0))
    leaves = np.flatnonzero(tree.right == 0)
    assert (tree.last - tree.first)[leaves].sum() == len(tree.light_id)
    for node in leaves[tree.node[leaves, 13] >= 0]:
        assert tree.last[node] - tree.first[node] <= 8
        inside = tree.light_id[tree.first[node] : tree.last[node]]
        center, half_extent = tree.node[node, :3], tree.node[node, 3:6]
        assert np.all(bounds.box_min[inside] >= center - half_extent - 1e-5)
        assert np.all(bounds.box_max[inside] <= center + half_extent + 1e-5)


def test_points_come_from_the_camera_and_from_one_bounce():
    scene = floor_scene(lamps_overhead())
    world, tracer = open_scene(scene)
    p, n = surface_points(scene.camera, world, tracer, 20, 0)
    # Nothing is above the floor, so no bounce meets a surface.
    assert len(p) == 20 and np.all(n == UP) and np.all(np.abs(p[:, 2]) < 1e-3)
    assert len(np.unique(p, axis=0)) == 20


def test_the_command_writes_a_table_and_a_plot(tmp_path, capsys):
    file = tmp_path / "city.npz"
    shutil.copy(CITY, file)
    arguments = [
        "probe",
        file,
        "--points",
        fewer(10, 1),
        "--tree",
        "width=2",
        "--tree",
        "split=sah",
    ]
    assert main([str(argument) for argument in arguments]) == 0
    assert (tmp_path / "city-probe/probe.png").read_bytes().startswith(b"\x89PNG")
    with open(tmp_path / "city-probe/probe.csv", newline="") as table:
        rows = list(csv.DictReader(table))
    assert list(rows[0]) == COLUMNS.split()
    assert {row["sampler"] for row in rows} == {
        *("lighttree", "width=2 split=sah", "power", "uniform", "cycles-style", "oracle p ~ f")
    }
    assert {row["lights"] for row in rows} == {"352"} and {row["scene"] for row in rows} == {"city"}
    for row in rows[:-1]:
        assert float(row["choose_ns"]) > 0 and float(row["rel_variance_mean"]) > 0
    assert rows[-1]["choose_ns"] == rows[-1]["variance_ns_mean"] == ""
    printed = capsys.readouterr().out
    assert "cycles-style" in printed and printed.strip().endswith("city-probe")


@pytest.mark.blender
def test_a_blend_is_probed_without_exporting_it_first(tmp_path, capsys):
    file = tmp_path / "city.blend"
    assert main(["scene", "city-small", "--lights", "200", "-o", str(file)]) == 0
    assert main(["probe", str(file), "--points", "5", "-o", str(tmp_path / "found")]) == 0
    assert (tmp_path / "found/probe.csv").exists() and (tmp_path / "found/probe.png").exists()


def looking_away():
    """The camera is below the floor and looks down."""
    return floor_scene(lamps_overhead(), camera=camera(position=(0, 0, -1)))


def in_the_dark():
    """The floor hides the lamp from the camera's side of it."""
    lamps = Lamps.empty(1)
    lamps.names, lamps.position[0], lamps.radiance[0] = ["Below"], [0, 0, -1], 1
    return floor_scene(lamps)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (floor_scene, "the scene has no light."),
        (
            partial(floor_scene, lamps_overhead(), albedo=0.0),
            "sees no surface that reflects light.",
        ),
        (looking_away, "sees no surface that reflects light."),
        (in_the_dark, "no light reaches what the camera sees."),
    ],
)
def test_a_scene_with_nothing_to_judge_is_refused_in_one_sentence(make, sentence, tmp_path, capsys):
    make().save(tmp_path / "x.npz")
    assert main(["probe", str(tmp_path / "x.npz"), "--points", "5"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("lighttree: ") and line.endswith(sentence)


def test_bad_arguments_are_refused_in_one_sentence(tmp_path, capsys):
    shutil.copy(CITY, tmp_path / "x.npz")
    for arguments, sentence in (
        (["missing.npz"], "missing.npz: no such file."),
        ([tmp_path / "x.npz", "--points", "0"], "greater than or equal to 1"),
        ([tmp_path / "x.npz", "--tree", "depth=3"], "there is no tree option 'depth'"),
        ([tmp_path / "x.npz", "--tree", "width=wide"], "'wide' is not a whole number"),
    ):
        assert main(["probe", *map(str, arguments)]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("lighttree: ") and sentence in line
