"""What the nodes yield that turn numbers and colours into others, and those that are constants.

A function takes a NodeReader and an output socket; it returns a Value, or None if that is not
modelled. Formulas are of (3, N) arrays, see `values.fold`, and those of Cycles' src/kernel/svm;
test_converters.py compares with renders.
"""

from __future__ import annotations

import numpy as np

from lighttree_core.scene import BACK

from .math_nodes import (
    BLENDS,
    MATH,
    VECTOR_MATH,
    clamp01,
    from_hsl,
    from_hsv,
    map_range,
    to_hsl,
    to_hsv,
    turn_hue,
)
from .values import STEPS, Value, by_angle, combine, fold

FROM_COLOR = {"HSV": to_hsv, "HSL": to_hsl}
TO_COLOR = {"HSV": from_hsv, "HSL": from_hsl}
# Polynomials in 1000 K / T, lowest power first: what Light.temperature_color gives within 0.4 %.
BLACKBODY_RGB = np.array(
    [
        [0.6683, 1.0282, 11.9935, -21.4781, 21.811, -12.2703, 2.8501],
        [0.9504, 0.9717, -6.0911, 8.7396, -7.3397, 3.5702, -0.7621],
        [2.3234, -9.1318, -6.9404, 117.2784, -315.2838, 377.9621, -177.142],
    ]
)
NO_BLUE_BELOW = 1905.0  # kelvin


def _fold(reader, function, *keys):
    """function of what arrives at some inputs; of their means where no table row can say it."""
    values = [reader.value(key) for key in keys]

    def finite(*numbers):
        with np.errstate(all="ignore"):
            result = np.asarray(function(*numbers), float)
        return np.where(np.isfinite(result), result, 0.0)

    exact = fold(finite, values)
    if exact is None:
        means = [reader.mean(key, value) for key, value in zip(keys, values, strict=True)]
        exact = fold(finite, means)
    return exact


def _own_value(reader, socket):
    numbers = socket.default_value
    return Value.of(numbers[:3] if socket.type == "RGBA" else numbers)


def _geometry(reader, socket):
    is_back = float(reader.side == BACK)
    return Value.of(is_back) if socket.identifier == "Backfacing" else None


def _math(reader, socket):
    node = reader.node
    operation = MATH.get(node.operation)
    if operation is None:
        return None
    keys = _keys_in_use(node, 3)

    def function(*numbers):
        result = operation(*numbers, *[np.zeros(1)] * (3 - len(keys)))
        return clamp01(result) if node.use_clamp else result

    return _fold(reader, function, *keys)


def _vector_math(reader, socket):
    node = reader.node
    if node.operation in VECTOR_MATH:
        return _fold(reader, VECTOR_MATH[node.operation], 0, 1, 3)
    operation = MATH.get(node.operation)
    if operation is None:
        return None
    keys = _keys_in_use(node, 3)
    unused = [np.zeros(1)] * (3 - len(keys))
    return _fold(reader, lambda *numbers: operation(*numbers, *unused), *keys)


def _keys_in_use(node, num):
    """The first inputs, without those that the operation has no use for."""
    return [key for key in range(num) if node.inputs[key].enabled]


def _mix(reader, socket):
    node = reader.node
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
    if kind is None:
        return None
    is_uneven = kind == "Vector" and node.factor_mode == "NON_UNIFORM"
    factor = "Factor_Vector" if is_uneven else "Factor_Float"
    blend = BLENDS[node.blend_type if kind == "Color" else "MIX"]

    def function(t, a, b):
        result = blend(clamp01(t) if node.clamp_factor else t, a, b)
        return clamp01(result) if kind == "Color" and node.clamp_result else result

    return _fold(reader, function, factor, f"A_{kind}", f"B_{kind}")


def _mix_rgb(reader, socket):
    node = reader.node

    def function(t, a, b):
        result = BLENDS[node.blend_type](clamp01(t), a, b)
        return clamp01(result) if node.use_clamp else result

    return _fold(reader, function, "Fac", "Color1", "Color2")


def _map_range(reader, socket):
    node = reader.node
    keys = ["Value", "From Min", "From Max", "To Min", "To Max", "Steps"]
    if node.data_type == "FLOAT_VECTOR":
        keys = ["Vector"] + [key.replace(" ", "_") + "_FLOAT3" for key in keys[1:]]

    def function(value, from_min, from_max, to_min, to_max, steps):
        kind = node.interpolation_type
        result = map_range(kind, value, from_min, from_max, to_min, to_max, steps)
        ends = np.minimum(to_min, to_max), np.maximum(to_min, to_max)
        return np.clip(result, *ends) if node.clamp else result

    return _fold(reader, function, *keys)


def _clamp(reader, socket):
    in_order = reader.node.clamp_type == "RANGE"

    def function(value, low, high):
        if in_order:
            low, high = np.minimum(low, high), np.maximum(low, high)
        return np.minimum(np.maximum(value, low), high)

    return _fold(reader, function, "Value", "Min", "Max")


def _invert(reader, socket):
    return _fold(reader, lambda t, x: t * (1 - x) + (1 - t) * x, "Fac", "Color")


def _gamma(reader, socket):
    def function(x, gamma):
        return np.where((x > 0) | (gamma == 0), np.power(np.maximum(x, 0), gamma), x)

    return _fold(reader, function, "Color", "Gamma")


def _bright_contrast(reader, socket):
    def function(x, bright, contrast):
        return np.maximum((1 + contrast) * x + bright - contrast / 2, 0)

    return _fold(reader, function, "Color", "Bright", "Contrast")


def _hue_saturation(reader, socket):
    return _fold(reader, turn_hue, "Hue", "Saturation", "Value", "Fac", "Color")


def _color_ramp(reader, socket):
    ramp, is_alpha = reader.node.color_ramp, socket.identifier == "Alpha"

    def function(x):
        rgba = np.transpose([ramp.evaluate(place) for place in clamp01(x[0]).tolist()])
        return rgba[3] if is_alpha else rgba[:3]

    return _fold(reader, function, "Fac")


def _curves(color_key):
    """A node of curves, one for each number, after one for all in the RGB Curves node."""

    def output(reader, socket):
        mapping = reader.node.mapping
        mapping.initialize()
        curves = list(mapping.curves)

        def function(t, x):
            one_each = curves[:3] if len(curves) >= 3 else curves[:1] * 3
            rows = x.tolist()
            for each in ([curves[3]] * 3, one_each) if len(curves) == 4 else (one_each,):
                pairs = zip(each, rows, strict=True)
                rows = [[mapping.evaluate(curve, number) for number in row] for curve, row in pairs]
            return (1 - t) * x + t * np.array(rows)

        first = "Factor" if reader.has_input("Factor") else "Fac"
        return _fold(reader, function, first, color_key)

    return output


def _separate(*channels):
    def output(reader, socket):
        key, mode = reader.node.inputs[0].identifier, getattr(reader.node, "mode", "RGB")
        index = channels.index(socket.identifier)
        if mode == "RGB":
            return reader.value(key).channel(index)
        return _fold(reader, lambda rgb: FROM_COLOR[mode](rgb)[index], key)

    return output


def _combine(*channels):
    def output(reader, socket):
        mode = getattr(reader.node, "mode", "RGB")
        if mode != "RGB":
            return _fold(reader, lambda *x: TO_COLOR[mode]([a[0] for a in x]), *channels)
        values = [reader.value(key) for key in channels]
        means = zip(channels, values, strict=True)
        return combine(*values) or combine(*(reader.mean(*pair) for pair in means))

    return output


def _to_grey(reader, socket):
    color = reader.value("Color")
    return color.as_number("RGBA") or reader.mean("Color", color).as_number("RGBA")


def _blackbody(reader, socket):
    return _fold(reader, blackbody_color, "Temperature")


def blackbody_color(kelvin):
    """(3, N) linear Rec.709 of black bodies of luminance 1; kelvin: three equal rows."""
    kelvin = np.clip(kelvin[0], 800.0, 12000.0)
    powers = (1000.0 / kelvin) ** np.arange(BLACKBODY_RGB.shape[1])[:, None]
    rgb = np.maximum(BLACKBODY_RGB @ powers, 0.0)
    rgb[2] *= kelvin > NO_BLUE_BELOW
    return rgb


def _light_path(reader, socket):
    reader.note(f"{socket.name} of {reader.node.name} is not modelled; 0 is used.")
    return Value.of(0.0)


def _fresnel(reader, socket):
    _note_bent_normal(reader)
    ior = max(reader.number("IOR"), 1e-5)
    return by_angle(_reflectance(1 / ior if reader.side == BACK else ior))


def _layer_weight(reader, socket):
    _note_bent_normal(reader)
    blend = min(reader.number("Blend"), 1 - 1e-5)
    if socket.identifier == "Fresnel":
        ior = 1 - blend
        return by_angle(_reflectance(ior if reader.side == BACK else 1 / ior))
    blend = max(blend, 0.0)
    return by_angle(1 - STEPS ** (2 * blend if blend < 0.5 else 0.5 / (1 - blend)))


def _note_bent_normal(reader):
    bent = reader.bent_normal()
    if bent:
        name = reader.node.name
        reader.note(f"Normal of {name} comes from {bent.node.name}, which is left out there.")


def _unoccluded(reader, socket):
    """Ambient occlusion where nothing is near: a share of 1, or the colour that it would darken."""
    reader.note(f"{reader.node.name} is not modelled; every place is taken as an open one.")
    return reader.value("Color") if socket.identifier == "Color" else Value.of(1.0)


def _reflectance(ior):
    """Fresnel's equations for a dielectric at the cosines of `STEPS`."""
    sin_t_sq = (1 - STEPS**2) / ior**2
    cos_i, cos_t = STEPS, np.sqrt(np.maximum(1 - sin_t_sq, 0.0))
    with np.errstate(invalid="ignore"):
        parallel = (ior * cos_i - cos_t) / (ior * cos_i + cos_t)
        perpendicular = (cos_i - ior * cos_t) / (cos_i + ior * cos_t)
    reflected = (parallel**2 + perpendicular**2) / 2
    return np.where(sin_t_sq >= 1, 1.0, reflected)


CONVERTERS = {
    "ShaderNodeRGB": _own_value,
    "ShaderNodeValue": _own_value,
    "ShaderNodeNewGeometry": _geometry,
    "ShaderNodeMath": _math,
    "ShaderNodeVectorMath": _vector_math,
    "ShaderNodeMix": _mix,
    "ShaderNodeMixRGB": _mix_rgb,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeInvert": _invert,
    "ShaderNodeGamma": _gamma,
    "ShaderNodeBrightContrast": _bright_contrast,
    "ShaderNodeHueSaturation": _hue_saturation,
    "ShaderNodeValToRGB": _color_ramp,
    "ShaderNodeRGBCurve": _curves("Color"),
    "ShaderNodeVectorCurve": _curves("Vector"),
    "ShaderNodeFloatCurve": _curves("Value"),
    "ShaderNodeSeparateColor": _separate("Red", "Green", "Blue"),
    "ShaderNodeSeparateXYZ": _separate("X", "Y", "Z"),
    "ShaderNodeSeparateRGB": _separate("R", "G", "B"),
    "ShaderNodeCombineColor": _combine("Red", "Green", "Blue"),
    "ShaderNodeCombineXYZ": _combine("X", "Y", "Z"),
    "ShaderNodeCombineRGB": _combine("R", "G", "B"),
    "ShaderNodeRGBToBW": _to_grey,
    "ShaderNodeBlackbody": _blackbody,
    "ShaderNodeLightPath": _light_path,
    "ShaderNodeFresnel": _fresnel,
    "ShaderNodeLayerWeight": _layer_weight,
    "ShaderNodeAmbientOcclusion": _unoccluded,
}
