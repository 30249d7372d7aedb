"""What a scene uses of LightTree, told without rendering: `lighttree render FILE --explain`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from lighttree_core import Scene
from lighttree_core import scene as kinds
from lighttree_core.lights import build_lights, count_lights
from lighttree_core.world import is_see_through, rays_that_meet_lamps

CLOSURE_NAMES = {
    kinds.DIFFUSE: "rough diffuse",
    kinds.TRANSLUCENT: "translucent",
    kinds.TRANSPARENT: "transparent",
    kinds.GLOSSY: "glossy",
    kinds.REFRACTION: "refraction",
    kinds.GLASS: "glass",
    kinds.PRINCIPLED: "principled",
}
FEATURE_WORDS = {
    "lobes": "surfaces beyond plain diffuse ones",
    "gloss": "reflections, which lights are chosen by too",
    "transmission": "light that passes through surfaces and is scattered",
    "transparency": "surfaces that light passes straight through",
    "textures": "images, colour attributes and normal maps on surfaces",
    "smooth_normals": "smooth shading",
    "met_lamps": "lamps that the camera or reflections see",
    "environment": "an image as the world",
    "light_flags": "lights that some rays do not see, without shadow, or of few bounces",
    "film_alpha": "a transparent film",
}


def explain_scene(scene: Scene) -> dict[str, Any]:
    """The facts that `tell` puts into words."""
    scene.check()
    textures, image = scene.textures, scene.environment.image
    num_bytes = textures.texels.nbytes + textures.float_texels.nbytes + image.nbytes
    return {
        "size_px": [scene.camera.width_px, scene.camera.height_px],
        "triangles": len(scene.triangles),
        "materials": len(scene.materials.names),
        "lights": count_lights(build_lights(scene)[0]),
        "closures": dict(Counter(CLOSURE_NAMES[kind] for kind in scene.closures.kind.tolist())),
        "textures": len(textures.kind),
        "images": len(textures.size) + (image.size > 0),
        "images_mib": num_bytes / 2**20,
        "features": find_features(scene),
        "not_modelled": list(scene.not_modelled),
    }


def find_features(scene: Scene) -> dict[str, bool]:
    """Whether a scene uses what FEATURE_WORDS lists."""
    lamps, closures, materials = scene.lamps, scene.closures, scene.materials
    environment, transmission = scene.environment, kinds.TRANSMISSION
    transmits = np.isin(closures.kind, (kinds.TRANSLUCENT, kinds.REFRACTION, kinds.GLASS))
    transmits |= (closures.kind == kinds.PRINCIPLED) & (
        (closures.values[:, transmission] != 0)
        | (closures.value_texture[:, transmission] != kinds.NO_TEXTURE)
    )
    texture_ids = np.concatenate(
        [np.ravel(ids) for ids in (*closures.texture_ids, materials.emission_texture)]
    )
    has_extent = (lamps.kind != kinds.POINT) & ((lamps.radius > 0) | lamps.axis_u.any(axis=1))
    is_met = has_extent & (lamps.visible & rays_that_meet_lamps(closures) != 0)
    has_light_flags = (
        np.any(lamps.visible | kinds.CAMERA_RAY != kinds.ALL_RAYS)
        or _hides_emitters(scene)
        or not lamps.casts_shadow.all()
        or np.any(lamps.max_bounces < kinds.ALL_BOUNCES)
        or environment.visible != kinds.ALL_RAYS
        or environment.max_bounces != kinds.ALL_BOUNCES
    )
    found = {
        "lobes": len(closures.kind) > 0,
        "gloss": np.isin(closures.kind, (kinds.GLOSSY, kinds.PRINCIPLED)).any(),
        "transmission": transmits.any(),
        "transparency": is_see_through(closures),
        "textures": np.any(texture_ids != kinds.NO_TEXTURE),
        "smooth_normals": len(scene.corner_normals) > 0,
        "met_lamps": is_met.any(),
        "environment": environment.image.size > 0,
        "light_flags": has_light_flags,
        "film_alpha": scene.film_transparent,
    }
    return {name: bool(is_used) for name, is_used in found.items()}


def _hides_emitters(scene: Scene) -> bool:
    """Whether some scattered rays do not meet what emits."""
    visible, emits = scene.triangle_visible(), scene.materials.emission.any(axis=(1, 2))
    is_hidden = (visible | kinds.CAMERA_RAY) & kinds.ALL_RAYS != kinds.ALL_RAYS
    return bool(np.any(emits[scene.triangle_material[np.flatnonzero(is_hidden)]]))


def tell(facts: dict[str, Any]) -> Iterator[str]:
    """The lines to be printed."""
    yield "{} x {} pixels".format(*facts["size_px"])
    yield _count(facts["triangles"], "triangle")
    yield f"{_count(facts['materials'], 'material')}{_kinds(facts['closures'], 'closure')}"
    yield f"{_count(sum(facts['lights'].values()), 'light')}{_kinds(facts['lights'])}"
    images = f"{_count(facts['images'], 'image')} of {facts['images_mib']:.1f} MiB"
    yield f"{_count(facts['textures'], 'texture')}, {images}"
    yield "Uses: plain diffuse surfaces and lights"
    yield from (f"  {words}" for name, words in FEATURE_WORDS.items() if facts["features"][name])
    if not facts["not_modelled"]:
        yield "Modelled as a whole."
    yield from (f"Not modelled: {sentence}" for sentence in facts["not_modelled"])


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _kinds(counts: dict[str, int], what: str = "") -> str:
    """': 3 point, 1 sun', most first."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    parts = ", ".join(f"{number:,} {name}" for name, number in ordered)
    ending = f" {what}{'' if sum(counts.values()) == 1 else 's'}" if what else ""
    return f": {parts}{ending}" if parts else ""
