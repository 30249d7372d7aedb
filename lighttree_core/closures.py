"""Closures of a material -> lobes at a hit: fetches their inputs and sets the lobes up.

As Cycles does from 4.5 to 5.2, whose shaders a scene's closures come from. Every closure's lobes
weigh `weight` x `weight_texture`; of those without other use for it, also COLOR.
"""

from .closure_parts import (
    MIN_IOR,
    View,
    add_diffuse,
    add_glass,
    can_add,
    load_color,
    reflecting_normal,
    reflection_scale,
)
from .fresnel import clamp01
from .jit import ONE, ZERO, called_kernel, kernel
from .lobes import set_microfacet, set_shading_normal, set_translucent, set_transparent
from .normal_maps import bumped_normal, mapped_normal
from .principled import add_principled
from .scene import (
    ALPHA,
    BACK,
    COAT_TINT,
    COLOR,
    DIFFUSE,
    GLASS,
    GLOSSY,
    IOR,
    NUM_VALUES,
    PRINCIPLED,
    REFRACTION,
    ROUGHNESS,
    SPECULAR_TINT,
    TRANSLUCENT,
    TRANSPARENT,
    Closures,
)
from .tables import column_table
from .textures import texture_value
from .vec import add, load3, mul, scale

# `scene.Closures` for kernels.
ClosureTable = column_table("ClosureTable", Closures, __name__)


@called_kernel
def setup_lobes(world, triangle, side, bary_u, bary_v, n_geo, n_shade, wo, lobes):
    """Fill `lobes` with what the closures of one side of a triangle come to; how many there are.

    n_geo, n_shade: see `surface.load_surface`; both, like wo, on the given side.
    """
    set_shading_normal(lobes, n_shade)
    material, num = world.geometry.material[triangle], 0
    first = world.first_closure[material, side]
    for row in range(first, first + world.num_closures[material, side]):
        weight = load_inputs(world, row, triangle, bary_u, bary_v, wo, lobes.inputs)
        normal = closure_normal(world, row, triangle, side, bary_u, bary_v, wo, n_geo, n_shade)
        reflecting = normal if normal == n_geo else reflecting_normal(n_geo, wo, normal)
        view = View(wo, n_geo, n_shade, normal, reflecting, side == BACK)
        num = add_closure(world, row, weight, view, lobes, num)
    return num


@kernel
def closure_normal(world, row, triangle, side, bary_u, bary_v, wo, n_geo, n_shade):
    """The normal of a closure: n_shade, tilted by its normal map, then by its bump map."""
    geometry, textures, normal = world.geometry, world.textures, n_shade
    texture, strength = world.closures.normal_texture[row], world.closures.normal_strength[row]
    if texture >= 0:
        normal = mapped_normal(
            geometry, textures, texture, strength, triangle, bary_u, bary_v, wo, n_geo, normal, side
        )
    height, strength = world.closures.height_texture[row], world.closures.bump_strength[row]
    if height >= 0:
        normal = bumped_normal(
            geometry, textures, height, strength, triangle, bary_u, bary_v, normal
        )
    return normal


@kernel
def load_inputs(world, row, triangle, bary_u, bary_v, wo, inputs):
    """Write the inputs of a closure at a point of a triangle to `inputs`; its weight there."""
    weight = load3(world.closures.weight, row)
    for column in range(NUM_VALUES):
        inputs[column] = world.closures.values[row, column]
    if len(world.textures.kind) > 0:
        weight = load_textures(world, row, triangle, bary_u, bary_v, wo, weight, inputs)
    return max(weight[0], ZERO), max(weight[1], ZERO), max(weight[2], ZERO)


@kernel
def load_textures(world, row, triangle, bary_u, bary_v, wo, weight, inputs):
    """Overwrite the inputs of a closure that have textures; its weight times its texture."""
    # From -1: the weight's texture, so that the code of textures is compiled in only once.
    for column in range(-1, NUM_VALUES):
        texture = world.closures.weight_texture[row]
        if column >= 0:
            texture = world.closures.value_texture[row, column]
        if texture >= 0:
            rgb = texture_value(
                world.geometry, world.textures, texture, triangle, bary_u, bary_v, wo
            )
            if column < 0:
                weight = mul(weight, rgb)
            else:
                inputs[column] = rgb[0]
                if column in (COLOR, SPECULAR_TINT, COAT_TINT):
                    inputs[column + 1], inputs[column + 2] = rgb[1], rgb[2]
    return weight


@kernel
def add_closure(world, row, weight, view, lobes, num):
    """The lobes of a closure whose inputs are in `lobes.inputs`; the number of lobes."""
    kind, multiscatter = world.closures.kind[row], world.closures.multiscatter[row]
    tables, inputs = world.albedo_tables, lobes.inputs
    if kind == PRINCIPLED:
        return add_principled(lobes, num, weight, tables, view, multiscatter)
    color = load_color(inputs, COLOR)
    if kind == GLASS:
        tints = (ONE, ONE, ONE), color, color
        return add_glass(lobes, num, weight, tables, view, multiscatter, tints)
    weight = mul(weight, color)
    if kind == DIFFUSE:
        return add_diffuse(lobes, num, weight, view, inputs[ROUGHNESS], color)
    if not can_add(weight, num):
        return num
    if kind == TRANSLUCENT:
        set_translucent(lobes, num, weight, view.reflecting)
    elif kind == TRANSPARENT:
        set_transparent(lobes, num, weight)
    else:
        set_microfacets(lobes, num, weight, tables, view, kind == GLOSSY and multiscatter, kind)
    return num + 1


@kernel
def set_microfacets(lobes, num, weight, tables, view, multiscatter, kind):
    """The lobe of a GLOSSY or REFRACTION closure."""
    inputs = lobes.inputs
    roughness, ior = clamp01(inputs[ROUGHNESS]), ONE
    if kind == REFRACTION:
        ior = max(inputs[IOR], MIN_IOR)
        ior = ONE / ior if view.is_back else ior
    if multiscatter:
        color = load_color(inputs, COLOR)
        weight = mul(weight, reflection_scale(tables, view, roughness, color)[0])
    reflects, alpha = kind == GLOSSY, roughness * roughness
    set_microfacet(lobes, num, weight, view.reflecting, alpha, ior, reflects, not reflects)


@called_kernel
def straight_transparency(world, triangle, side, bary_u, bary_v, wo, inputs):
    """What `lobes.transparency` tells of a hit, without setting up all lobes; wo may be turned
    round."""
    material, passed = world.geometry.material[triangle], (ZERO, ZERO, ZERO)
    first = world.first_closure[material, side]
    for row in range(first, first + world.num_closures[material, side]):
        kind = world.closures.kind[row]
        if kind in (TRANSPARENT, PRINCIPLED):
            weight = load_inputs(world, row, triangle, bary_u, bary_v, wo, inputs)
            if kind == PRINCIPLED:
                clear = scale(weight, ONE - clamp01(inputs[ALPHA]))
            else:
                clear = mul(weight, load_color(inputs, COLOR))
            passed = add(passed, clear)
    return passed
