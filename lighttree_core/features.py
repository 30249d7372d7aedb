"""What of the renderer a scene needs: kernels are compiled for just that.

A feature is ON or OFF, True or None. Their types differ, so numba compiles a kernel once for each
combination it meets, and `if is_on(...)` is decided before the code is optimized: a diffuse city
pays nothing for glass. Where a feature comes as an argument of its own, `if feature is not None`
is decided earlier still, and what follows is not even compiled.
"""

from typing import NamedTuple

import numpy as np

from .jit import kernel
from .scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    ALPHA,
    CAMERA_RAY,
    DIFFUSE,
    DIFFUSE_RAY,
    GLASS,
    GLOSSY,
    NO_TEXTURE,
    POINT,
    PRINCIPLED,
    REFRACTION,
    TRANSLUCENT,
    TRANSMISSION,
    TRANSPARENT,
    Scene,
)

ON, OFF = True, None


class Features(NamedTuple):
    """Each field is ON or OFF.

    lobes: surfaces that are more than Lambertian. gloss: reflections on some, which lights are
    chosen by too. transmission: light passes through some. transparency: straight through.
    textures, smooth_normals: on any surface. met_lamps: lamps with extent that rays meet, those of
    the camera or of glossy surfaces. environment: an image of it. light_flags: lights that some
    rays do not see, that cast no shadow or that end after some bounces. film_alpha: an image with
    an alpha channel. light_passes: the image's light apart by where it comes from, which a user
    asks for and no scene needs.
    """

    lobes: bool | None
    gloss: bool | None
    transmission: bool | None
    transparency: bool | None
    textures: bool | None
    smooth_normals: bool | None
    met_lamps: bool | None
    environment: bool | None
    light_flags: bool | None
    film_alpha: bool | None
    light_passes: bool | None


@kernel
def is_on(feature):
    """Whether a feature is ON."""
    return feature is not None


def find_features(scene: Scene, light_passes: bool = False) -> Features:
    """What a scene needs, and what a user wants of it."""
    lamps, closures, materials = scene.lamps, scene.closures, scene.materials
    kind, is_principled = closures.kind, closures.kind == PRINCIPLED
    has_extent = (lamps.kind != POINT) & ((lamps.radius > 0) | lamps.axis_u.any(axis=1))
    meets_lamps = has_extent & (lamps.visible & rays_that_meet_lamps(scene) != 0)
    environment = scene.environment
    light_flags = (
        np.any(lamps.visible | CAMERA_RAY != ALL_RAYS)
        or _hides_emitters(scene)
        or not lamps.casts_shadow.all()
        or np.any(lamps.max_bounces < ALL_BOUNCES)
        or (environment.visible, environment.max_bounces) != (ALL_RAYS, ALL_BOUNCES)
    )
    found = Features(
        lobes=len(kind) > 0,
        gloss=np.isin(kind, (GLOSSY, PRINCIPLED)).any(),
        transmission=np.isin(kind, (TRANSLUCENT, REFRACTION, GLASS)).any()
        or _may_differ(closures, is_principled, TRANSMISSION, 0.0),
        transparency=np.any(kind == TRANSPARENT)
        or _may_differ(closures, is_principled, ALPHA, 1.0),
        textures=any(
            np.any(ids != NO_TEXTURE) for ids in (*closures.texture_ids, materials.emission_texture)
        ),
        smooth_normals=len(scene.corner_normals) > 0,
        met_lamps=meets_lamps.any(),
        environment=environment.image.size > 0,
        light_flags=light_flags,
        film_alpha=scene.film_transparent,
        light_passes=light_passes,
    )
    return Features(*(ON if needed else OFF for needed in found))


def _hides_emitters(scene: Scene) -> bool:
    """Whether some scattered rays do not meet what emits."""
    visible, emits = scene.triangle_visible(), scene.materials.emission.any(axis=(1, 2))
    is_hidden = (visible | CAMERA_RAY) & ALL_RAYS != ALL_RAYS
    return bool(np.any(emits[scene.triangle_material[np.flatnonzero(is_hidden)]]))


def rays_that_meet_lamps(scene: Scene) -> int:
    """Bits of the rays that look for lamps: those of the camera, and where something is glossy."""
    is_glossy = ~np.isin(scene.closures.kind, (DIFFUSE, TRANSLUCENT, TRANSPARENT))
    return ALL_RAYS & ~DIFFUSE_RAY if is_glossy.any() else CAMERA_RAY


def _may_differ(closures, rows, column: int, value: float) -> bool:
    """Whether a value of some closures is, or may be, another one."""
    differs = closures.values[rows, column] != value
    return bool(np.any(differs | (closures.value_texture[rows, column] != NO_TEXTURE)))
