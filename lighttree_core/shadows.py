"""Shadow rays: adding the light that arrives, whole or through surfaces."""

from .closures import straight_transparency
from .jit import ONE, ZERO, kernel
from .ray_visibility import meets
from .scene import SHADOW_RAY
from .surface import load_surface
from .vec import load3, madd, max_abs, mul, normalize, store3, sub
from .waves import add_light


@kernel
def add_unblocked(shadow, num_shadow, is_blocked, samples):
    """Add the light of shadow rays that met nothing."""
    for i in range(num_shadow):
        if not is_blocked[i]:
            add_arriving(shadow, i, load3(shadow.radiance, i), samples)


@kernel
def add_arriving(shadow, i, light, samples):
    """Add the light of shadow ray i to its sample."""
    share = load3(shadow.matt_share, i)
    add_light(samples, shadow.slot[i], light, shadow.bounce[i], share)


@kernel
def move_shadow(shadow, i, k):
    """Copy to row k what shadow ray i keeps behind a surface, all but its places and its light."""
    shadow.slot[k], shadow.passes[k] = shadow.slot[i], shadow.passes[i]
    shadow.bounce[k] = shadow.bounce[i]
    store3(shadow.matt_share, k, load3(shadow.matt_share, i))


@kernel
def pass_surfaces(world, shadow, hits, num_shadow, lobes, samples):
    """Take each shadow ray through the surface it met, as far as that is transparent or hidden.

    Adds the light of those that meet nothing more; how many are left, moved to the front.
    """
    num_left = 0
    for i in range(num_shadow):
        triangle, light = hits.triangle[i], load3(shadow.radiance, i)
        if triangle < 0:
            add_arriving(shadow, i, light, samples)
            continue
        is_met = meets(world.geometry, triangle, SHADOW_RAY)
        if is_met and shadow.passes[i] <= 0:
            continue
        to_light, u, v = load3(shadow.to_light, i), hits.u[i], hits.v[i]
        _, p_behind, _, _, side = load_surface(world.geometry, triangle, u, v, to_light)
        if is_met:
            wo = normalize(to_light)
            through = straight_transparency(world, triangle, side, u, v, wo, lobes.inputs)
            light = mul(light, through)
            if max_abs(light) == ZERO:
                continue
        target = madd(load3(shadow.origin, i), ONE, to_light)
        move_shadow(shadow, i, num_left)
        shadow.passes[num_left] -= 1 if is_met else 0
        store3(shadow.origin, num_left, p_behind)
        store3(shadow.to_light, num_left, sub(target, p_behind))
        store3(shadow.radiance, num_left, light)
        num_left += 1
    return num_left
