"""What each shader node looks like; inputs as Cycles 4.5 to 5.2 defines them."""

from __future__ import annotations

import numpy as np

from lighttree_core.scene import (
    ALPHA,
    COAT_IOR,
    COAT_ROUGHNESS,
    COAT_TINT,
    COAT_WEIGHT,
    COLOR,
    DIFFUSE,
    DIFFUSE_ROUGHNESS,
    GLASS,
    GLOSSY,
    IOR,
    METALLIC,
    PRINCIPLED,
    REFRACTION,
    ROUGHNESS,
    SPECULAR_LEVEL,
    SPECULAR_TINT,
    TRANSLUCENT,
    TRANSMISSION,
    TRANSPARENT,
)

from .looks import BLACK, ONE, ZERO, Look, Part, add, reflects, scale
from .values import Projection, Value

# Inputs of the Principled BSDF without which it is rendered, unless they are 0.
PRINCIPLED_EXTRAS = (
    "Subsurface Weight",
    "Sheen Weight",
    "Anisotropic",
    "Thin Film Thickness",
    "Thin Wall",
)
UNIT, NOT_NEGATIVE = (0.0, 1.0), (0.0, np.inf)
PRINCIPLED_INPUTS = {
    "Base Color": (COLOR, NOT_NEGATIVE),
    "Metallic": (METALLIC, UNIT),
    "Roughness": (ROUGHNESS, UNIT),
    "IOR": (IOR, NOT_NEGATIVE),
    "Alpha": (ALPHA, UNIT),
    "Diffuse Roughness": (DIFFUSE_ROUGHNESS, UNIT),
    "Specular IOR Level": (SPECULAR_LEVEL, NOT_NEGATIVE),
    "Specular Tint": (SPECULAR_TINT, NOT_NEGATIVE),
    "Transmission Weight": (TRANSMISSION, UNIT),
    "Coat Weight": (COAT_WEIGHT, NOT_NEGATIVE),
}
COAT_INPUTS = {
    "Coat Roughness": (COAT_ROUGHNESS, UNIT),
    "Coat IOR": (COAT_IOR, (1.0, np.inf)),
    "Coat Tint": (COAT_TINT, NOT_NEGATIVE),
}
# Cycles' default surface since 5.0.
PRINCIPLED_DEFAULTS = {
    COLOR: 0.8,
    METALLIC: 0.0,
    ROUGHNESS: 0.5,
    IOR: 1.5,
    ALPHA: 1.0,
    DIFFUSE_ROUGHNESS: 0.0,
    SPECULAR_LEVEL: 0.5,
    SPECULAR_TINT: 1.0,
    TRANSMISSION: 0.0,
    COAT_WEIGHT: 0.0,
}
CLEAR = Look((Part(TRANSPARENT, ((COLOR, ONE),)),))
DEFAULT_LOOK = Look(
    (
        Part(
            PRINCIPLED,
            tuple((column, Value.of(number)) for column, number in PRINCIPLED_DEFAULTS.items()),
            multiscatter=True,
        ),
    )
)


def matt(color) -> Look:
    """A Lambertian surface of a colour, (3,)."""
    return Look((Part(DIFFUSE, ((COLOR, Value.of(color)), (ROUGHNESS, ZERO))),))


def _read(node, inputs):
    """(column, Value) of inputs, constants brought within their limits."""
    return tuple(
        (column, node.value(key).within(*limits)) for key, (column, limits) in inputs.items()
    )


def _normal(node):
    """The fields of a Part for the normal and bump maps at an input Normal."""
    source = node.bent_normal()
    if source is None:
        return {}
    kind = source.node.bl_idname
    if kind == "ShaderNodeBump":
        return _bump(source)
    if kind == "ShaderNodeNormalMap" and source.node.space == "TANGENT":
        return _normal_map(source)
    node.note(f"Normal of {node.node.name} comes from {source.node.name}, which is left out.")
    return {}


def _bump(node):
    """A height, in metres, over what arrives at the node's own Normal."""
    below, strength = _normal(node), max(node.number("Strength"), 0.0)
    height = _height(node, node.number("Distance") * (-1 if node.node.invert else 1))
    if height is None or strength == 0:
        return below
    if "height" in below:
        node.note(f"of bumps upon bumps only {node.node.name} is rendered.")
    return below | {"height": height, "bump_strength": strength}


def _height(node, factor):
    """The input Height times a factor, None where it is the same everywhere."""
    height = node.value("Height").times(Value.of(factor))
    if height.is_by_angle:
        node.note(f"Height of {node.node.name} is left out, as it hangs on the ray.")
        return None
    return height if height.texture else None


def displaced(look: Look, node) -> Look:
    """A look with a Displacement node's heights as bumps, of parts whose normal nothing else bends.

    As in Cycles with Bump Only; its heights in object space grow with the object, these do not.
    """
    if node.node.bl_idname != "ShaderNodeDisplacement":
        node.note(f"the displacement by {node.node.name} is left out.")
        return look
    if node.node.space == "OBJECT":
        node.note(f"heights of {node.node.name} are those of objects of scale 1.")
    height = _height(node, node.number("Scale"))
    if height is None:
        return look
    parts = (
        part if part.normal or part.height else part._replace(height=height) for part in look.parts
    )
    return look._replace(parts=tuple(parts))


def _normal_map(node):
    color, strength = node.value("Color"), node.number("Strength")
    if color.texture is None or strength == 0:
        if strength and not np.allclose(color.bias, (0.5, 0.5, 1.0), atol=1e-6):
            node.note(f"{node.node.name} is left out, as its Color is the same everywhere.")
        return {}
    if getattr(node.node, "convention", "OPENGL") == "DIRECTX":
        color = color.times(Value.of((1, -1, 1))).plus(Value.of((0, 1, 0)))
    uv_map, shown_on = node.node.uv_map, color.texture.uv_map
    if isinstance(shown_on, Projection):
        node.note(f"{node.node.name} has the tangents of {shown_on.space} coordinates.")
    elif uv_map and shown_on and uv_map != shown_on:
        node.note(f"{node.node.name} has the tangents of the UV map {shown_on}.")
    return {"normal": color, "normal_strength": strength}


def _simple(kind, *scalars):
    """A shader of a colour and some numbers."""
    inputs = {"Color": (COLOR, NOT_NEGATIVE)} | {
        key: (column, UNIT if column == ROUGHNESS else NOT_NEGATIVE) for key, column in scalars
    }

    def shader(node):
        has_normal = node.has_input("Normal")
        multiscatter = _distribution(node)
        _note_extras(node, ("Anisotropy", "Thin Film Thickness"))
        normal = _normal(node) if has_normal else {}
        return Look((Part(kind, _read(node, inputs), multiscatter=multiscatter, **normal),))

    return shader


def _distribution(node):
    """Whether light scattered between microfacets counts; notes other distributions than GGX."""
    distribution = getattr(node.node, "distribution", "GGX")
    if distribution not in ("GGX", "MULTI_GGX") and not node.is_constant("Roughness", 0):
        name = distribution.replace("_", "-").title()
        node.note(f"the distribution {name} of {node.node.name} is rendered as GGX.")
    return distribution == "MULTI_GGX"


def _note_extras(node, keys):
    lost = [key for key in keys if node.has_input(key) and not node.is_constant(key, 0)]
    if lost:
        node.note(f"{node.node.name.split('.')[0]} is rendered without {', '.join(lost)}.")


def _emission(node):
    """Emission, and Background: seen from both sides."""
    return Look((), _radiance(node, "Color", "Strength"))


def _radiance(node, color, strength):
    """W/(m^2 sr): colour * strength, as in Cycles."""
    watts = node.value(strength)
    if watts.is_always(0):
        return ZERO
    emitted = node.value(color)
    product = emitted.times(watts)
    return product or emitted.times(node.mean(strength, watts))


def _principled(node):
    """Alpha scales the emission too; without gloss and metal the rest is a Diffuse BSDF."""
    _note_extras(node, PRINCIPLED_EXTRAS)
    values = _read(node, PRINCIPLED_INPUTS)
    part = Part(PRINCIPLED, values, multiscatter=_distribution(node), **_normal(node))
    coat, alpha = part.value(COAT_WEIGHT), part.value(ALPHA)
    emission = _radiance(node, "Emission Color", "Emission Strength")
    if not coat.is_always(0):
        part = part._replace(values=values + _read(node, COAT_INPUTS))
        if node.source("Coat Normal")[0].is_output:
            node.note(f"{node.node.name} is rendered without Coat Normal.")
        if not emission.is_always(0):
            node.note(f"the coat of {node.node.name} does not darken its emission.")
    is_plain = all(
        (
            *(part.value(column).is_always(0) for column in (METALLIC, TRANSMISSION, COAT_WEIGHT)),
            alpha.is_always(1),
            not reflects(part.value(IOR), part.value(SPECULAR_LEVEL)),
        )
    )
    if is_plain:
        plain = (COLOR, part.value(COLOR)), (ROUGHNESS, part.value(DIFFUSE_ROUGHNESS))
        part = part._replace(kind=DIFFUSE, values=plain, multiscatter=False)
    seen = emission.times(alpha)
    return Look((part,), seen or emission.times(node.mean("Alpha", alpha)))


def _metallic(node):
    """A Principled BSDF that is all metal.

    Of a conductor's n and k its reflectance along the normal and at 82 degrees, between which the
    F82 model draws a curve near that of Fresnel's equations.
    """
    _note_extras(node, ("Anisotropy", "Thin Film Thickness"))
    if node.node.fresnel_type == "F82":
        base, tint = (node.value(key).within(*UNIT) for key in ("Base Color", "Edge Tint"))
    else:
        n, k = (np.maximum(node.color(key), 0.0) for key in ("IOR", "Extinction"))
        f0, f82 = _conductor(n, k, 1.0), _conductor(n, k, 1 / 7)
        base, tint = Value.of(f0), Value.of(f82 / (f0 + (1 - f0) * (6 / 7) ** 5))
        node.note(f"{node.node.name} is rendered with the F82 model that is nearest to its IOR.")
    values = PRINCIPLED_DEFAULTS | {METALLIC: 1.0}
    values = {column: Value.of(number) for column, number in values.items()}
    values |= {COLOR: base, SPECULAR_TINT: tint}
    values[ROUGHNESS] = node.value("Roughness").within(*UNIT)
    multiscatter = _distribution(node)
    return Look((Part(PRINCIPLED, tuple(values.items()), ONE, multiscatter, **_normal(node)),))


def _conductor(n, k, cos_i):
    """Fresnel reflectance of a conductor of complex index n + ik, unpolarized light."""
    index = n + 1j * k
    cos_t = np.sqrt(1 - (1 - cos_i**2) / index**2)
    perpendicular = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    parallel = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return (np.abs(perpendicular) ** 2 + np.abs(parallel) ** 2) / 2


def _add(node):
    return add(node.look(0), node.look(1), node.note)


def _mix(node):
    """Only shaders with a share are read, so that the others cause no notes."""
    share = node.value(0).within(*UNIT)
    rest = share.times(Value.of(-1)).plus(ONE)
    look = BLACK
    for key, part in ((1, rest), (2, share)):
        if not part.is_always(0):
            look = add(look, scale(node.look(key), part, node.note), node.note)
    return look


def _holdout(node):
    node.note(f"{node.node.name} is rendered black.")
    return BLACK


def _volume(node):
    """Nothing: of a surface, a volume shader has no say."""
    return BLACK


def _other(node):
    """Any other shader as diffuse in its colour, black where it has none."""
    if not node.has_input("Color"):
        return _holdout(node)
    node.note(f"{node.node.name} is rendered as diffuse.")
    color = node.value("Color").within(*NOT_NEGATIVE)
    return Look((Part(DIFFUSE, ((COLOR, color), (ROUGHNESS, ZERO))),))


SHADERS = {
    "ShaderNodeBsdfDiffuse": _simple(DIFFUSE, ("Roughness", ROUGHNESS)),
    "ShaderNodeBsdfTranslucent": _simple(TRANSLUCENT),
    "ShaderNodeBsdfTransparent": _simple(TRANSPARENT),
    "ShaderNodeBsdfGlossy": _simple(GLOSSY, ("Roughness", ROUGHNESS)),
    "ShaderNodeBsdfAnisotropic": _simple(GLOSSY, ("Roughness", ROUGHNESS)),
    "ShaderNodeBsdfRefraction": _simple(REFRACTION, ("Roughness", ROUGHNESS), ("IOR", IOR)),
    "ShaderNodeBsdfGlass": _simple(GLASS, ("Roughness", ROUGHNESS), ("IOR", IOR)),
    "ShaderNodeBsdfMetallic": _metallic,
    "ShaderNodeBsdfPrincipled": _principled,
    "ShaderNodeEmission": _emission,
    "ShaderNodeBackground": _emission,
    "ShaderNodeAddShader": _add,
    "ShaderNodeMixShader": _mix,
    "ShaderNodeHoldout": _holdout,
    "ShaderNodeVolumeAbsorption": _volume,
    "ShaderNodeVolumeCoefficients": _volume,
    "ShaderNodeVolumePrincipled": _volume,
    "ShaderNodeVolumeScatter": _volume,
    None: _other,
}
