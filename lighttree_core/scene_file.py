"""Scenes as versioned .npz files: arrays as they are, and the rest as one JSON text."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from .scene import Camera, Closures, Environment, Lamps, Materials, Scene, SceneError, Textures

FORMAT_VERSION = 3
TABLES = ("materials", "lamps", "closures", "textures", "environment")
ARRAYS = (
    "vertices",
    "triangles",
    "triangle_material",
    "corner_normals",
    "uvs",
    "colors",
    "background",
    "object_first_triangle",
    "object_visible",
)


def save_scene(scene: Scene, path: Path) -> None:
    """Write what `load_scene` reads; the file appears whole or not at all."""
    arrays = {name: getattr(scene, name) for name in ARRAYS}
    arrays["camera.world_from_camera"] = scene.camera.world_from_camera
    camera = {k: v for k, v in asdict(scene.camera).items() if k != "world_from_camera"}
    facts = {"format_version": FORMAT_VERSION, "camera": camera}
    for name in ("not_modelled", "object_names", "film_transparent"):
        facts[name] = getattr(scene, name)
    for name in TABLES:
        table = getattr(scene, name)
        for column in fields(table):
            value = getattr(table, column.name)
            kind = arrays if isinstance(value, np.ndarray) else facts
            kind[f"{name}.{column.name}"] = value
    arrays["facts"] = np.array(json.dumps(facts))
    part = path.with_name(path.name + ".part")
    try:
        with open(part, "wb") as file:
            np.savez_compressed(file, **arrays)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def load_scene(path: str | os.PathLike) -> Scene:
    """Read what `save_scene` wrote; SceneError if it is damaged or of a later format."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        facts = json.loads(str(arrays["facts"]))
        version = int(facts["format_version"])
        if version <= FORMAT_VERSION:
            return _from_parts(arrays, facts)
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such file.") from None
    except Exception as error:
        # Damaged bytes make zipfile, zlib, numpy and json raise all kinds of errors.
        raise SceneError(
            f"{path}: damaged, or not a scene that LightTree exported "
            f"({type(error).__name__}). Export it again."
        ) from error
    raise SceneError(
        f"{path}: written by a later LightTree (scene format {version}, this one reads "
        f"{FORMAT_VERSION}). Update LightTree, or export the scene again with this one."
    )


def _from_parts(arrays: dict, facts: dict) -> Scene:
    parts = facts | arrays

    def num(name):
        return len(parts.get(name, ()))

    def table(name, default):
        # Columns that came after the file was written are as in a table without them.
        columns = {f.name: parts.get(f"{name}.{f.name}") for f in fields(default)}
        return replace(default, **{k: v for k, v in columns.items() if v is not None})

    camera = Camera(
        world_from_camera=arrays["camera.world_from_camera"],
        **{**facts["camera"], "crop_px": tuple(facts["camera"]["crop_px"])},
    )
    return Scene(
        camera=camera,
        materials=table("materials", Materials.empty(num("materials.names"))),
        lamps=table("lamps", Lamps.empty(num("lamps.names"))),
        closures=table("closures", Closures.empty(num("closures.kind"))),
        textures=table("textures", Textures.empty(num("textures.kind"), num("textures.size"))),
        environment=table("environment", Environment()),
        object_names=facts["object_names"],
        not_modelled=facts["not_modelled"],
        film_transparent=facts.get("film_transparent", False),
        **{name: arrays[name] for name in ARRAYS if name in arrays},
    )
