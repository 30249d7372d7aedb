"""What a scene needs of LightTree, told without rendering: `lighttree render FILE --explain`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from lighttree_core import Scene
from lighttree_core import scene as kinds
from lighttree_core.features import ON, find_features
from lighttree_core.lights import build_lights, count_lights

CLOSURE_NAMES = {
    kinds.DIFFUSE: "rough diffuse",
    kinds.TRANSLUCENT: "translucent",
    kinds.TRANSPARENT: "transparent",
    kinds.GLOSSY: "glossy",
    kinds.REFRACTION: "refraction",
    kinds.GLASS: "glass",
    kinds.PRINCIPLED: "principled",
}
# The fields of `Features` in words.
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
    "light_passes": "light told apart for passes",
}


def explain_scene(scene: Scene) -> dict[str, Any]:
    """The facts that `tell` puts into words."""
    scene.check()
    textures, image = scene.textures, scene.environment.image
    num_bytes = textures.texels.nbytes + textures.float_texels.nbytes + image.nbytes
    features = find_features(scene)._asdict()
    return {
        "size_px": [scene.camera.width_px, scene.camera.height_px],
        "triangles": len(scene.triangles),
        "materials": len(scene.materials.names),
        "lights": count_lights(build_lights(scene)[0]),
        "closures": dict(Counter(CLOSURE_NAMES[kind] for kind in scene.closures.kind.tolist())),
        "textures": len(textures.kind),
        "images": len(textures.size) + (image.size > 0),
        "images_mib": num_bytes / 2**20,
        "features": {name: feature == ON for name, feature in features.items()},
        "not_modelled": list(scene.not_modelled),
    }


def tell(facts: dict[str, Any]) -> Iterator[str]:
    """The lines to be printed."""
    yield "{} x {} pixels".format(*facts["size_px"])
    yield _count(facts["triangles"], "triangle")
    yield f"{_count(facts['materials'], 'material')}{_kinds(facts['closures'], 'closure')}"
    yield f"{_count(sum(facts['lights'].values()), 'light')}{_kinds(facts['lights'])}"
    images = f"{_count(facts['images'], 'image')} of {facts['images_mib']:.1f} MiB"
    yield f"{_count(facts['textures'], 'texture')}, {images}"
    for is_needed, words in ((True, "Compiled in"), (False, "Left out")):
        names = [name for name, needed in facts["features"].items() if needed == is_needed]
        if is_needed:
            yield f"{words}: diffuse surfaces, emission, lights of all kinds"
        elif names:
            yield f"{words}, as nothing in the scene needs it:"
        yield from (f"  {FEATURE_WORDS[name]}" for name in names)
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
