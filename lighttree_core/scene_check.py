"""Whether a scene can be rendered: what is wrong is told with the object's name and the way out."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from .scene import (
    COLOR_ATTRIBUTE,
    DISK,
    ELLIPSE,
    FACING,
    IMAGE_TEXTURE,
    LAMP_KINDS,
    NO_CONE,
    NO_TEXTURE,
    RECTANGLE,
    SPHERE,
    SUN,
    Camera,
    Closures,
    Lamps,
    Materials,
    Scene,
    SceneError,
    Textures,
)

DAMAGED = "The scene is damaged ({}): export it again."


def check_scene(scene: Scene) -> None:
    """Raise SceneError if a scene cannot be rendered."""
    _check_camera(scene.camera)
    _check_lamps(scene.lamps)
    _check_table(scene.materials, Materials.empty(len(scene.materials.names)), "material")
    is_finite = np.isfinite(scene.environment.image).all()
    backgrounds = scene.background, *scene.environment.camera_color
    if any(np.shape(color) != (3,) for color in backgrounds):
        raise SceneError(DAMAGED.format("background"))
    for color in backgrounds:
        if not np.isfinite(color).all():
            raise SceneError(f"The world's background is {color}: set a finite colour.")
    if not (is_finite and np.isfinite(scene.environment.local_from_world).all()):
        raise SceneError("The world's image has pixels that are not finite: repair or replace it.")
    _check_geometry(scene)
    _check_surfaces(scene)


def _check_surfaces(scene: Scene) -> None:
    """Closures, textures, and what they need at the corners of triangles."""
    closures, textures, materials = scene.closures, scene.textures, scene.materials
    num_triangles = len(scene.triangles)
    _check_shapes(closures, Closures.empty(len(closures.kind)), "closures")
    empty = Textures.empty(len(textures.kind), len(textures.size))
    _check_shapes(textures, empty, "textures", skip=("texels", "float_texels"))
    for name, values, shape in (
        ("corner normals", scene.corner_normals, (3, 3)),
        ("texture coordinates", scene.uvs, (num_triangles, 3, 2)),
        ("colour attributes", scene.colors, (num_triangles, 3, 3)),
    ):
        if len(values) and not (values.shape[1:] == shape and np.isfinite(values).all()):
            raise SceneError(DAMAGED.format(name))
    if len(scene.corner_normals) not in (0, num_triangles):
        raise SceneError(DAMAGED.format("corner normals"))
    first, num = materials.first_closure, materials.num_closures
    if np.any((first < 0) | (num < 0) | (first + num > len(closures.kind))):
        raise SceneError(DAMAGED.format("closures of materials"))
    for ids in (*closures.texture_ids, materials.emission_texture):
        if np.any((ids < NO_TEXTURE) | (ids >= len(textures.kind))):
            raise SceneError(DAMAGED.format("textures of closures"))
    is_color = textures.kind == COLOR_ATTRIBUTE
    limits = np.where(is_color, len(scene.colors), len(textures.size))
    maps = np.where(textures.kind == IMAGE_TEXTURE, len(scene.uvs), textures.uv_map + 1)
    is_lost = (textures.source < 0) | (textures.source >= limits) | (textures.uv_map >= maps)
    if np.any(is_lost & (textures.kind != FACING)):
        raise SceneError(DAMAGED.format("images of textures"))
    num_texels = np.where(textures.is_float, len(textures.float_texels), len(textures.texels))
    last = textures.first_texel + textures.size.prod(axis=1, dtype=np.int64)
    if np.any((textures.size < 1).any(axis=1) | (textures.first_texel < 0) | (last > num_texels)):
        raise SceneError(DAMAGED.format("pixels of images"))
    curve = textures.curve
    is_row = textures.is_float & (textures.size[:, 0] > 1) & (textures.size[:, 1] == 1)
    if np.any((curve < NO_TEXTURE) | ~np.isin(curve, [NO_TEXTURE, *np.flatnonzero(is_row)])):
        raise SceneError(DAMAGED.format("curves of textures"))


def _check_shapes(table, expected, what: str, skip: tuple[str, ...] = ()) -> None:
    """Raise SceneError if a column has another shape or is not finite."""
    for column in fields(expected):
        values = getattr(table, column.name)
        if column.name not in skip and (
            values.shape != getattr(expected, column.name).shape or not np.isfinite(values).all()
        ):
            raise SceneError(DAMAGED.format(f"{column.name} of {what}"))


def _check_camera(camera: Camera) -> None:
    x0, y0, x1, y1 = camera.crop_px
    if not (0 <= x0 < x1 <= camera.width_px and 0 <= y0 < y1 <= camera.height_px):
        raise SceneError(
            f"The border covers no pixel ({x1 - x0} x {y1 - y0} of {camera.width_px} x "
            f"{camera.height_px}): draw a larger one or switch it off."
        )
    numbers = [camera.half_width, camera.half_height, camera.shift_x, camera.shift_y]
    numbers += [camera.lens_radius, camera.focus_distance, camera.blade_rotation]
    if (
        camera.world_from_camera.shape != (3, 4)
        or not np.isfinite([*numbers, *camera.world_from_camera.ravel()]).all()
    ):
        raise SceneError("The camera's position or lens is not a finite number: reset it.")
    if camera.lens_radius < 0 or not camera.lens_ratio > 0:
        raise SceneError("The camera's aperture has no positive size: set its F-stop and ratio.")


def _check_table(table, expected, what: str) -> None:
    """Raise SceneError if a column lacks rows, has another shape, or is not finite."""
    for column in fields(expected):
        if column.name == "names":
            continue
        values = getattr(table, column.name)
        if values.shape != getattr(expected, column.name).shape:
            raise SceneError(f"The table of {what}s is damaged: export the scene again.")
        is_bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        if is_bad.any():
            quality = COLUMN_WORDS.get(column.name, column.name.replace("_", " "))
            raise SceneError(
                f"{what.capitalize()} {table.names[int(np.argmax(is_bad))]!r}: its {quality} is "
                f"not a finite number: set one, or keep the {what} out of the render."
            )


COLUMN_WORDS = {"radiance": "energy or colour", "albedo": "colour"}


def _check_lamps(lamps: Lamps) -> None:
    _check_table(lamps, Lamps.empty(len(lamps.names)), "light")
    kind, is_spot = lamps.kind, lamps.cos_cone != NO_CONE
    is_flat, is_round = np.isin(kind, (RECTANGLE, ELLIPSE)), np.isin(kind, (SPHERE, DISK))
    is_shapeless = np.zeros(len(kind), bool)
    u, v = (axis[is_flat].astype(np.float64) for axis in (lamps.axis_u, lamps.axis_v))
    is_shapeless[is_flat] = ~np.cross(u, v).any(axis=1)
    frames = np.stack([a[is_spot] for a in (lamps.axis_u, lamps.axis_v, lamps.axis_w)], axis=1)
    is_shapeless[is_spot] |= np.linalg.det(frames.astype(np.float64)) == 0
    is_aimed = is_flat | (kind == SUN)
    for is_bad, fault in (
        (~np.isin(kind, LAMP_KINDS), "unknown kind"),
        (is_round & (lamps.radius <= 0) | (lamps.radius < 0), "its radius is not above zero"),
        ((kind == SUN) & (lamps.radius > np.float32(np.pi)), "a sun wider than the sky"),
        (is_flat & is_shapeless, "it has no area"),
        (is_aimed & ~lamps.axis_w.any(axis=1), "it has no direction"),
        (is_spot & is_shapeless, "a spot whose scale is zero"),
        (
            is_spot & ~((lamps.cos_cone > -1e-6) & (lamps.cos_cone <= 1)),
            "its cone is not within 0 to 180 degrees",
        ),
        (is_spot & ~((lamps.blend >= 0) & (lamps.blend <= 1)), "its blend is not within 0 to 1"),
        (
            is_flat & ~((lamps.spread > 0) & (lamps.spread <= np.float32(np.pi))),
            "its spread is not within 0 to 180 degrees",
        ),
    ):
        if is_bad.any():
            name = lamps.names[int(np.argmax(is_bad))]
            raise SceneError(f"Light {name!r}: {fault}. Correct it, or hide it from renders.")


def _check_geometry(scene: Scene) -> None:
    triangles, num_vertices = scene.triangles, len(scene.vertices)
    if len(scene.triangle_material) != len(triangles):
        raise SceneError(
            "Every triangle needs one material: the scene is damaged, export it again."
        )
    for values, limit in (
        (triangles, num_vertices),
        (scene.triangle_material, len(scene.materials.names)),
    ):
        if len(values) and not (values.min() >= 0 and values.max() < limit):
            raise SceneError(
                "A triangle names a vertex or material that does not exist: export again."
            )
    if len(scene.object_visible):
        first = scene.object_first_triangle
        steps = np.diff(first, prepend=0, append=len(triangles))
        if len(scene.object_visible) != len(first) or np.any(steps < 0) or first[0] != 0:
            raise SceneError(DAMAGED.format("visibility of objects"))
    is_bad = ~np.isfinite(scene.vertices).all(axis=1)
    if is_bad.any():
        bad_triangles = np.flatnonzero(is_bad[triangles].any(axis=1))
        if len(bad_triangles):
            name = scene.object_of_triangle(int(bad_triangles[0]))
            raise SceneError(
                f"Object {name!r}: a vertex is not at a finite position: repair the mesh "
                "(Mesh > Clean Up) or hide the object from renders."
            )
