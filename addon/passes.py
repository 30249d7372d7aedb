"""The passes of an image: which are wanted, what Blender calls them, what of the film they show."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import bpy
import numpy as np
from bpy.props import BoolProperty, PointerProperty

from lighttree_core import Film
from lighttree_core.film import LIGHT_PASSES


class Pass(NamedTuple):
    """name, channels and kind: as Blender knows it. read: film -> (H, W, channels)."""

    name: str
    channels: str
    kind: str
    read: Callable[[Film], np.ndarray]


COMBINED = Pass("Combined", "RGBA", "COLOR", lambda film: np.dstack([film.mean, film.alpha]))
DEPTH = Pass("Depth", "Z", "VALUE", lambda film: film.depth)
NORMAL = Pass("Normal", "XYZ", "VECTOR", lambda film: film.normal)
ALBEDO = Pass("Albedo", "RGB", "COLOR", lambda film: film.albedo)
VARIANCE = Pass("Variance", "RGB", "COLOR", lambda film: film.variance)
LIGHT_NAMES = (
    ("Emission", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color")
    if bpy.app.version >= (5, 0)
    else ("Emit", "DiffDir", "DiffInd", "DiffCol")
)
LIGHT = {
    key: Pass(name, "RGB", "COLOR", partial(Film.light_pass, name=key))
    for key, name in zip(LIGHT_PASSES, LIGHT_NAMES, strict=True)
}


class LightTreeLayerSettings(bpy.types.PropertyGroup):
    """Passes that Blender has no switch for, kept with each view layer as `layer.lighttree`."""

    use_pass_variance: BoolProperty(
        name="Variance",
        description="Of the pixel's mean, by which noise can be told from detail",
        default=False,
    )


def wanted_light_passes(layer) -> list[Pass]:
    """Those of a view layer that light has to be told apart for while it is gathered."""
    switches = {
        "emission": layer.use_pass_emit,
        "diffuse_direct": layer.use_pass_diffuse_direct,
        "diffuse_indirect": layer.use_pass_diffuse_indirect,
        "diffuse_color": layer.use_pass_diffuse_color,
    }
    return [LIGHT[key] for key, is_on in switches.items() if is_on]


def wanted_passes(layer) -> list[Pass]:
    """All passes of a view layer; Albedo, which denoisers ask for, is always among them."""
    wanted = [COMBINED, ALBEDO, *wanted_light_passes(layer)]
    wanted += [DEPTH] if layer.use_pass_z else []
    wanted += [NORMAL] if layer.use_pass_normal else []
    wanted += [VARIANCE] if layer.lighttree.use_pass_variance else []
    return wanted


def register():
    bpy.utils.register_class(LightTreeLayerSettings)
    bpy.types.ViewLayer.lighttree = PointerProperty(type=LightTreeLayerSettings)


def unregister():
    del bpy.types.ViewLayer.lighttree
    bpy.utils.unregister_class(LightTreeLayerSettings)
