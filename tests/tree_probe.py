"""Questions to a light sampler: what it expects at a point, what it picks there, what is in it."""

import numpy as np
import oracle
from hypothesis import strategies as st

from lighttree_core.light_points import light_radiance, sample_light_point
from lighttree_core.light_tree.importance import Receiver, matt_gloss
from lighttree_core.light_tree.nodes import NUM_COLUMNS, NUM_LANES
from lighttree_core.light_tree.options import (
    BUCKET_KINDS,
    CONE_AXES,
    IMPORTANCES,
    SPLITS,
    TreeOptions,
)
from lighttree_core.light_tree.sample import (
    TREE,
    allocate_picks,
    build_sampler,
    expected_picks,
    sample_lights,
)
from lighttree_core.lights import bound_lights, build_lights
from lighttree_core.sampling import uniform_pair

UP = (np.float32(0), np.float32(0), np.float32(1))
DOWN = (np.float32(0), np.float32(0), np.float32(-1))
ORIGIN = (np.float32(0), np.float32(0), np.float32(0))
NUM_PICKS = (1, 2, 4, 16)
# The least and the largest numbers that a uniform variable may take, and some between.
EDGE_US = (0.0, 2.0**-149, 2.0**-53, 0.25, 0.5, 1 - 2.0**-24, 1 - 2.0**-53)
# More than a point may ask for: a pick too many is then counted instead of written beyond the end.
MOST_PICKS = 64


def lane_table(tree):
    """The columns of all nodes as (n, NUM_COLUMNS, NUM_LANES)."""
    return tree.columns.reshape(-1, NUM_COLUMNS, NUM_LANES)


def vec3(a):
    """Three numbers as kernels take them."""
    return tuple(np.float32(x) for x in a)


def build(scene, strategy=TREE, options=None):
    """The light sampler of a scene."""
    lights, _, _ = build_lights(scene)
    return build_sampler(lights, bound_lights(lights), strategy, options)


def tree_options(**fixed):
    """A hypothesis strategy: all ways to build, weigh and walk a tree."""
    choices = {
        "split": st.sampled_from(SPLITS),
        "thin_box": st.booleans(),
        "buckets": st.sampled_from((0, 2, 12, 100)),
        "bucket_kind": st.sampled_from(BUCKET_KINDS),
        "cone_axis": st.sampled_from(CONE_AXES),
        "width": st.sampled_from((2, 4, 16)),
        "importance": st.sampled_from(IMPORTANCES),
        "split_threshold": st.sampled_from((0.0, 0.3, 1.0)),
    }
    return st.builds(TreeOptions, **{**choices, **{k: st.just(v) for k, v in fixed.items()}})


def random_points(rng, num):
    """Points among and below the lamps of `core_scenes.random_scene`, with normals at random."""
    for _ in range(num):
        n = rng.normal(size=3)
        yield vec3(rng.uniform([-10, -10, -1], [10, 10, 4])), vec3(n / np.linalg.norm(n))


def all_expected(sampler, p, n, num=1, gloss=None):
    """(num_lights,) how often each light is to be expected among the picks of a point."""
    room = allocate_picks(sampler, MOST_PICKS)
    num_lights = len(sampler.lights.kind)
    receiver = Receiver(p, n, False, gloss or matt_gloss(n))
    return np.array([expected_picks(sampler, i, receiver, num, room) for i in range(num_lights)])


def pick(sampler, p, n, num, u, gloss=None):
    """(lights, how often each was to be expected) of one point."""
    room = allocate_picks(sampler, MOST_PICKS)
    num_picked = sample_lights(sampler, Receiver(p, n, False, gloss or matt_gloss(n)), num, u, room)
    assert num_picked < MOST_PICKS
    return room.light[:num_picked].copy(), room.expected[:num_picked].copy()


def contributions(scene, p, n, num_samples=16):
    """(num_lights,) luminance of the irradiance that each light gives, W/m^2, by the oracle."""
    return (
        oracle.light_irradiances(scene, np.array(p, float), np.array(n, float), num_samples)
        @ oracle.LUMINANCE
    )


def assert_sound(sampler, p, n, f=None):
    """At one point: probabilities that add up, no pick but as told, and no light left out.

    f: contributions. Returns what is expected of each light when one is to be picked.
    """
    for num in NUM_PICKS:
        expected = all_expected(sampler, p, n, num)
        assert np.all((expected >= 0) & (expected <= 1))
        assert expected.sum() <= num * (1 + 1e-5)
        if f is not None:
            # Below this share float32 cannot tell whether the light grazes the surface.
            assert np.all(expected[np.abs(f) > 1e-6 * np.abs(f).sum()] > 0)
        for u in EDGE_US:
            lights, told = pick(sampler, p, n, num, u)
            assert len(lights) <= num
            assert np.all(told > 0)
            np.testing.assert_array_equal(told, expected[lights])
    return all_expected(sampler, p, n)


def frequencies(sampler, p, n, num, us):
    """(num_lights,) how often each light is picked on the average over some u."""
    counts = np.zeros(len(sampler.lights.kind))
    for u in us:
        np.add.at(counts, pick(sampler, p, n, num, u)[0], 1)
    return counts / len(us)


def middles(num):
    """The middles of `num` equal parts of the unit interval."""
    return (np.arange(num) + 0.5) / num


def second_moment(contributions, expected):
    """E[x^2] of an estimate by one pick, x = contribution / expected, over the square of its mean.

    One for a sampler that picks in proportion to contribution; its excess is the variance.
    """
    lit = contributions > 0
    return np.sum(contributions[lit] ** 2 / expected[lit]) / contributions.sum() ** 2


def lane_lights(tree, node=0):
    """{(node, lane): ids of the lights in it} for all lanes at and below a node."""
    lanes = {}
    for k in range(NUM_LANES):
        child = int(tree.child[node, k])
        if child > 0:
            below = lane_lights(tree, child)
            lanes.update(below)
            direct = (light for (at, _), lights in below.items() if at == child for light in lights)
            lanes[node, k] = sorted(direct)
        elif child < 0:
            lanes[node, k] = [~child]
    return lanes


def depth_of(tree, node=0):
    """Nodes on the longest way down from a node."""
    return 1 + max((depth_of(tree, child) for child in tree.child[node] if child > 0), default=0)


def assert_complete(scene, options=None):
    """The scene's sampler, after a look: each light in one lane, all numbers finite."""
    sampler = build(scene, options=options)
    lanes = lane_lights(sampler.tree)
    at_root = [light for (node, _), lights in lanes.items() if node == 0 for light in lights]
    assert sorted(at_root) == list(np.flatnonzero(bound_lights(sampler.lights).flux > 0))
    assert np.isfinite(lane_table(sampler.tree)[:, :6]).all()
    assert sampler.tree.depth == depth_of(sampler.tree)
    return sampler


def sampled_irradiance(lights, light, p, n, num):
    """Luminance of the irradiance that one light gives, by samples of its points: (num,)."""
    values = np.zeros(num)
    for i in range(num):
        wi, distance, pdf = sample_light_point(lights, light, p, n, False, uniform_pair(7, 0, i, 0))
        cos = np.dot(n, wi)
        if pdf > 0 and cos > 0:
            radiance = np.array(light_radiance(lights, light, wi, distance))
            values[i] = radiance @ oracle.LUMINANCE * cos / pdf
    return values
