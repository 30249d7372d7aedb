"""The scene as LightTree renders it: triangles, materials, lamps, camera and background.

Everything is in world space, in metres, radians, watts and linear Rec.709 RGB. Images have their
first row at the bottom, as in Blender. Triangles whose material emits become lights when a render
starts (`lights.build_lights`), so a scene stores an emitting mesh once, as geometry.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np

FORMAT_VERSION = 1

# Kinds of light. POINT is a delta position; DISK turns to face the shading point.
POINT, SPHERE, DISK, RECTANGLE, ELLIPSE, SUN, TRIANGLE, BACKGROUND = range(8)
LAMP_KINDS = (POINT, SPHERE, DISK, RECTANGLE, ELLIPSE, SUN)

FRONT, BACK = 0, 1
NO_CONE = -2.0  # cos_cone of a lamp that is not a spot


class SceneError(ValueError):
    """A scene that cannot be rendered or read; the message names the object and the way out."""


@dataclass
class Lamps:
    """Blender's light objects, one row each; L rows.

    kind: (L,) int32, one of LAMP_KINDS.
    position: (L, 3) centre, unused by SUN.
    axis_u, axis_v, axis_w: (L, 3). RECTANGLE and ELLIPSE: u, v are the full side vectors
        (diameters) in the world, w the unit direction of emission. SUN: w is the unit direction in
        which its light travels. Spots: a world direction d has the coordinates (d.u, d.v, d.w) in
        the spot's own, unscaled frame, w along the axis of the cone.
    radiance: (L, 3) W/(m^2 sr) along the axis. POINT: intensity, W/sr. SUN of radius 0:
        irradiance, W/m^2. Negative values take light away.
    radius: (L,) SPHERE and DISK: metres. SUN: half its angular diameter, radians.
    cos_cone: (L,) cosine of half the angle of a spot, NO_CONE for anything else.
    blend: (L,) share of the cone over which a spot fades, 0 to 1.
    spread: (L,) full angle within which an area light emits, radians; pi is Lambertian.
    names: object names, for messages.
    """

    kind: np.ndarray
    position: np.ndarray
    axis_u: np.ndarray
    axis_v: np.ndarray
    axis_w: np.ndarray
    radiance: np.ndarray
    radius: np.ndarray
    cos_cone: np.ndarray
    blend: np.ndarray
    spread: np.ndarray
    names: list[str]

    @classmethod
    def empty(cls, num_lamps: int = 0) -> Lamps:
        """A table of POINT lamps at the origin without light, to be filled."""
        vec3 = {
            name: np.zeros((num_lamps, 3), np.float32)
            for name in ("position", "axis_u", "axis_v", "axis_w", "radiance")
        }
        return cls(
            kind=np.full(num_lamps, POINT, np.int32),
            radius=np.zeros(num_lamps, np.float32),
            cos_cone=np.full(num_lamps, NO_CONE, np.float32),
            blend=np.zeros(num_lamps, np.float32),
            spread=np.full(num_lamps, np.pi, np.float32),
            names=[""] * num_lamps,
            **vec3,
        )


@dataclass
class Materials:
    """Surfaces, one row each; M rows. Index 0 of the second axis is the front, 1 the back.

    albedo: (M, 2, 3) Lambertian reflectance. emission: (M, 2, 3) radiance, W/(m^2 sr).
    light_sampled: (M, 2) bool, whether a side that emits is also sampled as a light; one that is
    not is found by scattered rays alone (same mean, other noise).
    """

    albedo: np.ndarray
    emission: np.ndarray
    light_sampled: np.ndarray
    names: list[str]

    @classmethod
    def empty(cls, num_materials: int = 0) -> Materials:
        """Black materials, to be filled."""
        return cls(
            albedo=np.zeros((num_materials, 2, 3), np.float32),
            emission=np.zeros((num_materials, 2, 3), np.float32),
            light_sampled=np.ones((num_materials, 2), bool),
            names=[""] * num_materials,
        )


@dataclass
class Camera:
    """A pinhole or orthographic camera looking along its local -Z.

    A point (x, y) of the image, in pixels from the lower left corner of the full frame, lies at
    ((2 x / width_px - 1) half_width + shift_x, (2 y / height_px - 1) half_height + shift_y)
    on the plane at distance 1 (perspective) or on the camera's own plane (orthographic).

    world_from_camera: (3, 4) float64, rotation and position, without scale.
    width_px, height_px: the full frame. crop_px: (x0, y0, x1, y1), the part that is rendered,
    x1 and y1 excluded. clip_start, clip_end: metres along the viewing axis.
    """

    world_from_camera: np.ndarray
    half_width: float
    half_height: float
    width_px: int
    height_px: int
    shift_x: float = 0.0
    shift_y: float = 0.0
    orthographic: bool = False
    clip_start: float = 0.0
    clip_end: float = 1e30
    crop_px: tuple[int, int, int, int] = (0, 0, 0, 0)

    def __post_init__(self):
        if tuple(self.crop_px) == (0, 0, 0, 0):
            self.crop_px = (0, 0, self.width_px, self.height_px)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the rendered image."""
        x0, y0, x1, y1 = self.crop_px
        return y1 - y0, x1 - x0


@dataclass
class Scene:
    """One frame, ready to render; see the classes of its parts for shapes and units.

    Parameters
    ----------
    camera : Camera
    vertices : (V, 3) float32
    triangles : (T, 3) int32, counter-clockwise seen from the front
    triangle_material : (T,) int32, row of `materials`
    materials : Materials
    lamps : Lamps
    background : (3,) float32, radiance of the world in every direction
    object_names : one per mesh instance, for messages
    object_first_triangle : (len(object_names),) int32, ascending
    not_modelled : what of the source differs here; one sentence each
    """

    camera: Camera
    vertices: np.ndarray
    triangles: np.ndarray
    triangle_material: np.ndarray
    materials: Materials
    lamps: Lamps = field(default_factory=Lamps.empty)
    background: np.ndarray = field(default_factory=lambda: np.zeros(3, np.float32))
    object_names: list[str] = field(default_factory=list)
    object_first_triangle: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    not_modelled: list[str] = field(default_factory=list)

    def check(self) -> None:
        """Raise SceneError, naming the object and the way out, if this cannot be rendered."""
        _check_camera(self.camera)
        _check_lamps(self.lamps)
        _check_table(self.materials, Materials.empty(len(self.materials.names)), "material")
        if self.background.shape != (3,) or not np.isfinite(self.background).all():
            raise SceneError(f"The world's background is {self.background}: set a finite colour.")
        _check_geometry(self)

    def object_of_triangle(self, triangle: int) -> str:
        """Name of the object a triangle belongs to."""
        if not self.object_names:
            return f"triangle {triangle}"
        return self.object_names[
            int(np.searchsorted(self.object_first_triangle, triangle, side="right")) - 1
        ]

    def save(self, path: str | os.PathLike) -> None:
        """Write a versioned .npz that `load` reads; it appears whole or not at all."""
        path = Path(path)
        arrays = {}
        facts = {"format_version": FORMAT_VERSION, "not_modelled": self.not_modelled}
        facts["object_names"] = self.object_names
        facts["camera"] = {k: v for k, v in asdict(self.camera).items() if k != "world_from_camera"}
        arrays["camera.world_from_camera"] = self.camera.world_from_camera
        for table in ("materials", "lamps"):
            for column in fields(getattr(self, table)):
                value = getattr(getattr(self, table), column.name)
                (facts if column.name == "names" else arrays)[f"{table}.{column.name}"] = value
        for name in SCENE_ARRAYS:
            arrays[name] = getattr(self, name)
        arrays["facts"] = np.array(json.dumps(facts))
        part = path.with_name(path.name + ".part")
        try:
            with open(part, "wb") as file:
                np.savez_compressed(file, **arrays)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Scene:
        """Read what `save` wrote; SceneError if the file is damaged or of a later format."""
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = dict(file)
            facts = json.loads(str(arrays["facts"]))
            version = int(facts["format_version"])
            if version <= FORMAT_VERSION:
                return cls._from_parts(arrays, facts)
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

    @classmethod
    def _from_parts(cls, arrays: dict, facts: dict) -> Scene:
        def table(kind, prefix):
            return kind(
                **{
                    column.name: (facts if column.name == "names" else arrays)[
                        f"{prefix}.{column.name}"
                    ]
                    for column in fields(kind)
                }
            )

        camera = Camera(
            world_from_camera=arrays["camera.world_from_camera"],
            **{**facts["camera"], "crop_px": tuple(facts["camera"]["crop_px"])},
        )
        return cls(
            camera=camera,
            materials=table(Materials, "materials"),
            lamps=table(Lamps, "lamps"),
            object_names=facts["object_names"],
            not_modelled=facts["not_modelled"],
            **{name: arrays[name] for name in SCENE_ARRAYS},
        )


SCENE_ARRAYS = (
    "vertices",
    "triangles",
    "triangle_material",
    "background",
    "object_first_triangle",
)


def _check_camera(camera: Camera) -> None:
    x0, y0, x1, y1 = camera.crop_px
    if not (0 <= x0 < x1 <= camera.width_px and 0 <= y0 < y1 <= camera.height_px):
        raise SceneError(
            f"The border covers no pixel ({x1 - x0} x {y1 - y0} of {camera.width_px} x "
            f"{camera.height_px}): draw a larger one or switch it off."
        )
    numbers = [camera.half_width, camera.half_height, camera.shift_x, camera.shift_y]
    if (
        camera.world_from_camera.shape != (3, 4)
        or not np.isfinite([*numbers, *camera.world_from_camera.ravel()]).all()
    ):
        raise SceneError("The camera's position or lens is not a finite number: reset it.")


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
    is_bad = ~np.isfinite(scene.vertices).all(axis=1)
    if is_bad.any():
        bad_triangles = np.flatnonzero(is_bad[triangles].any(axis=1))
        if len(bad_triangles):
            name = scene.object_of_triangle(int(bad_triangles[0]))
            raise SceneError(
                f"Object {name!r}: a vertex is not at a finite position: repair the mesh "
                "(Mesh > Clean Up) or hide the object from renders."
            )
