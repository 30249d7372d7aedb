"""The scene as LightTree renders it: triangles, materials, lamps, camera and background.

Everything is in world space, in metres, radians, watts and linear Rec.709 RGB. Images have their
first row at the bottom, as in Blender. Triangles whose material emits become lights when a render
starts (`lights.build_lights`), so a scene stores an emitting mesh once, as geometry.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

# Kinds of light. POINT is a delta position; DISK turns to face the shading point.
POINT, SPHERE, DISK, RECTANGLE, ELLIPSE, SUN, TRIANGLE, BACKGROUND = range(8)
LAMP_KINDS = (POINT, SPHERE, DISK, RECTANGLE, ELLIPSE, SUN)

FRONT, BACK = 0, 1
NO_CONE = -2.0  # cos_cone of a lamp that is not a spot

# Which rays meet a lamp, an object or the background; bits, as in Blender's Ray Visibility.
CAMERA_RAY, DIFFUSE_RAY, GLOSSY_RAY, TRANSMISSION_RAY, SHADOW_RAY = 1, 2, 4, 8, 16
ALL_RAYS = 15  # but shadow rays, which are asked of objects alone
# Lamps shine on paths of so many bounces at most.
ALL_BOUNCES = 1024

# Kinds of closure: what a surface does with light.
DIFFUSE, TRANSLUCENT, TRANSPARENT, GLOSSY, REFRACTION, GLASS, PRINCIPLED = range(7)
# Columns of `Closures.values`; colours take three.
COLOR, ROUGHNESS, IOR, METALLIC, TRANSMISSION, SPECULAR_LEVEL = 0, 3, 4, 5, 6, 7
SPECULAR_TINT, COAT_WEIGHT, COAT_ROUGHNESS, COAT_IOR, COAT_TINT = 8, 11, 12, 13, 14
DIFFUSE_ROUGHNESS, ALPHA = 17, 18
NUM_VALUES = 19
# What a principled closure is without further words, and any closure where it has no use.
DEFAULT_VALUES = (0.8, 0.8, 0.8, 0.5, 1.5, 0, 0, 0.5, 1, 1, 1, 0, 0.03, 1.5, 1, 1, 1, 0, 1)

NO_TEXTURE = -1
IMAGE_TEXTURE, COLOR_ATTRIBUTE, FACING = range(3)
REPEAT, EXTEND, CLIP, MIRROR = range(4)  # beyond the borders of an image
LINEAR, CLOSEST = range(2)  # between its texels
RGB, OPACITY, LUMINANCE_OF_RGB, RED, GREEN, BLUE = range(6)  # what is taken of it


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
    visible: (L,) int32, bits of the rays that meet it; DIFFUSE_RAY also stands for light sampling
        at diffuse surfaces. casts_shadow: (L,) bool. max_bounces: (L,) int32.
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
    visible: np.ndarray
    casts_shadow: np.ndarray
    max_bounces: np.ndarray
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
            visible=np.full(num_lamps, ALL_RAYS & ~CAMERA_RAY, np.int32),
            casts_shadow=np.ones(num_lamps, bool),
            max_bounces=np.full(num_lamps, ALL_BOUNCES, np.int32),
            names=[""] * num_lamps,
            **vec3,
        )


@dataclass
class Materials:
    """Surfaces, one row each; M rows. Index 0 of the second axis is the front, 1 the back.

    albedo: (M, 2, 3) Lambertian reflectance of a side without closures; of one with closures a
    mean colour, for the albedo pass alone. first_closure, num_closures: (M, 2) int32, rows of
    `Closures`. emission: (M, 2, 3) radiance, W/(m^2 sr). emission_texture: (M, 2) int32, a row of
    `Textures` that multiplies it, or NO_TEXTURE.
    light_sampled: (M, 2) bool, whether a side that emits is also sampled as a light; one that is
    not is found by scattered rays alone (same mean, other noise).
    """

    albedo: np.ndarray
    first_closure: np.ndarray
    num_closures: np.ndarray
    emission: np.ndarray
    emission_texture: np.ndarray
    light_sampled: np.ndarray
    names: list[str]

    @classmethod
    def empty(cls, num_materials: int = 0) -> Materials:
        """Black materials, to be filled."""
        return cls(
            albedo=np.zeros((num_materials, 2, 3), np.float32),
            first_closure=np.zeros((num_materials, 2), np.int32),
            num_closures=np.zeros((num_materials, 2), np.int32),
            emission=np.zeros((num_materials, 2, 3), np.float32),
            emission_texture=np.full((num_materials, 2), NO_TEXTURE, np.int32),
            light_sampled=np.ones((num_materials, 2), bool),
            names=[""] * num_materials,
        )


@dataclass
class Closures:
    """Parts of surfaces, C rows; those of one side of a material lie one after another and add up.

    kind: (C,) int32, DIFFUSE to PRINCIPLED. weight: (C, 3) how much of the closure there is.
    weight_texture: (C,) int32, a row of `Textures` that multiplies it. values: (C, NUM_VALUES)
    inputs as in Blender's nodes of that name, in the columns COLOR to ALPHA. value_texture: (C,
    NUM_VALUES) int32, rows of `Textures` in place of values, of a colour at its first column.
    multiscatter: (C,) bool, whether light scattered between microfacets is made up for.
    normal_texture: (C,) int32, a tangent-space normal map. normal_strength: (C,).
    height_texture: (C,) int32, a bump map, metres above the surface. bump_strength: (C,), 0 for the
    normal without it, 1 for that of a surface of these heights.
    """

    kind: np.ndarray
    weight: np.ndarray
    weight_texture: np.ndarray
    values: np.ndarray
    value_texture: np.ndarray
    multiscatter: np.ndarray
    normal_texture: np.ndarray
    normal_strength: np.ndarray
    height_texture: np.ndarray
    bump_strength: np.ndarray

    @classmethod
    def empty(cls, num_closures: int = 0) -> Closures:
        """Diffuse closures of weight 0, to be filled."""
        return cls(
            kind=np.full(num_closures, DIFFUSE, np.int32),
            weight=np.zeros((num_closures, 3), np.float32),
            weight_texture=np.full(num_closures, NO_TEXTURE, np.int32),
            values=np.tile(np.array(DEFAULT_VALUES, np.float32), (num_closures, 1)),
            value_texture=np.full((num_closures, NUM_VALUES), NO_TEXTURE, np.int32),
            multiscatter=np.ones(num_closures, bool),
            normal_texture=np.full(num_closures, NO_TEXTURE, np.int32),
            normal_strength=np.ones(num_closures, np.float32),
            height_texture=np.full(num_closures, NO_TEXTURE, np.int32),
            bump_strength=np.ones(num_closures, np.float32),
        )

    @property
    def texture_ids(self) -> tuple[np.ndarray, ...]:
        """The columns that are rows of `Textures`."""
        return self.weight_texture, self.value_texture, self.normal_texture, self.height_texture


@dataclass
class Textures:
    """Images, colour attributes and how much surfaces face the ray as inputs of closures; X rows.

    kind: (X,) int32; of FACING the cosine between ray and normal is taken. source: (X,) int32, an
    image, or of COLOR_ATTRIBUTE a row of `Scene.colors`. curve: (X,) int32, an image of one row
    through which each number that is taken goes, from 0 at its left end to 1 at the right one, or
    NO_TEXTURE.
    uv_map: (X,) int32, row of `Scene.uvs`. image_from_uv: (X, 2, 3) where in the image, 0 to 1 from
    its lower left corner, a point of the UV map lies. extension, interpolation, output: (X,) int32.
    divides_alpha: (X,) bool, whether colours are divided by alpha once they are interpolated.
    scale, bias: (X, 3); the input is bias + scale x what is taken of the texture.

    size: (I, 2) int32 width and height of each image. first_texel: (I,) int64 row of `texels`, or
    where is_float of `float_texels`, of its lower left texel; rows of the image follow from below.
    is_srgb: (I,) bool, whether texels are encoded by the sRGB curve, to be decoded after
    interpolation. texels: (N, 4) uint8 RGBA. float_texels: (F, 4) float32 RGBA.
    """

    kind: np.ndarray
    source: np.ndarray
    curve: np.ndarray
    uv_map: np.ndarray
    image_from_uv: np.ndarray
    extension: np.ndarray
    interpolation: np.ndarray
    output: np.ndarray
    divides_alpha: np.ndarray
    scale: np.ndarray
    bias: np.ndarray
    size: np.ndarray
    first_texel: np.ndarray
    is_float: np.ndarray
    is_srgb: np.ndarray
    texels: np.ndarray
    float_texels: np.ndarray

    @classmethod
    def empty(cls, num_textures: int = 0, num_images: int = 0) -> Textures:
        """Textures of the first image, without its texels, to be filled."""
        kinds = {
            name: np.zeros(num_textures, np.int32)
            for name in ("kind", "source", "uv_map", "extension", "interpolation", "output")
        }
        return cls(
            **kinds,
            curve=np.full(num_textures, NO_TEXTURE, np.int32),
            divides_alpha=np.zeros(num_textures, bool),
            image_from_uv=np.tile(np.eye(2, 3, dtype=np.float32), (num_textures, 1, 1)),
            scale=np.ones((num_textures, 3), np.float32),
            bias=np.zeros((num_textures, 3), np.float32),
            size=np.zeros((num_images, 2), np.int32),
            first_texel=np.zeros(num_images, np.int64),
            is_float=np.zeros(num_images, bool),
            is_srgb=np.zeros(num_images, bool),
            texels=np.zeros((0, 4), np.uint8),
            float_texels=np.zeros((0, 4), np.float32),
        )


@dataclass
class Environment:
    """What is seen where rays meet nothing, beside `Scene.background`, which multiplies the image.

    image: (H, W, 3) float32 or (0, 0, 3) for none, equirectangular, its first row at the bottom,
    laid out as Blender's Environment Texture. local_from_world: (3, 3) rotation of directions.
    visible: bits of the rays that see it. max_bounces: as of a lamp. camera_color: (1, 3) float32
    radiance that the camera sees in place of all this, or (0, 3) where it sees the same.
    """

    image: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    local_from_world: np.ndarray = field(default_factory=lambda: np.eye(3, dtype=np.float32))
    visible: int = ALL_RAYS
    max_bounces: int = ALL_BOUNCES
    camera_color: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))


@dataclass
class Camera:
    """A pinhole or orthographic camera looking along its local -Z.

    A point (x, y) of the image, in pixels from the lower left corner of the full frame, lies at
    ((2 x / width_px - 1) half_width + shift_x, (2 y / height_px - 1) half_height + shift_y)
    on the plane at distance 1 (perspective) or on the camera's own plane (orthographic).

    world_from_camera: (3, 4) float64, rotation and position, without scale.
    width_px, height_px: the full frame. crop_px: (x0, y0, x1, y1), the part that is rendered,
    x1 and y1 excluded. clip_start, clip_end: metres along the viewing axis.
    lens_radius: metres, 0 for a pinhole; focus_distance: metres along the viewing axis to what is
    sharp; num_blades: corners of the aperture, 0 for a round one; blade_rotation: radians;
    lens_ratio: how much narrower the aperture is than high.
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
    lens_radius: float = 0.0
    focus_distance: float = 10.0
    num_blades: int = 0
    blade_rotation: float = 0.0
    lens_ratio: float = 1.0

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
    closures : Closures
    textures : Textures
    corner_normals : (T, 3, 3) float32, unit shading normals at the corners of each triangle, on its
        front; (0, 3, 3) where all are flat
    uvs : (K, T, 3, 2) float32, K maps of texture coordinates at the corners
    colors : (K, T, 3, 3) float32, K colour attributes at the corners, linear
    background : (3,) float32, radiance of the world in every direction
    environment : Environment
    film_transparent : whether the camera sees through the film where it sees the background
    object_names : one per mesh instance, for messages
    object_first_triangle : (len(object_names),) int32, ascending
    object_visible : (len(object_names),) int32, bits of the rays that meet each object, SHADOW_RAY
        among them; (0,) where all meet all
    not_modelled : what of the source differs here; one sentence each
    """

    camera: Camera
    vertices: np.ndarray
    triangles: np.ndarray
    triangle_material: np.ndarray
    materials: Materials
    lamps: Lamps = field(default_factory=Lamps.empty)
    closures: Closures = field(default_factory=Closures.empty)
    textures: Textures = field(default_factory=Textures.empty)
    corner_normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3), np.float32))
    uvs: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3, 2), np.float32))
    colors: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3, 3), np.float32))
    background: np.ndarray = field(default_factory=lambda: np.zeros(3, np.float32))
    environment: Environment = field(default_factory=Environment)
    film_transparent: bool = False
    object_names: list[str] = field(default_factory=list)
    object_first_triangle: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    object_visible: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    not_modelled: list[str] = field(default_factory=list)

    def check(self) -> None:
        """Raise SceneError, naming the object and the way out, if this cannot be rendered."""
        from .scene_check import check_scene

        check_scene(self)

    def object_of_triangle(self, triangle: int) -> str:
        """Name of the object a triangle belongs to."""
        if not self.object_names:
            return f"triangle {triangle}"
        return self.object_names[
            int(np.searchsorted(self.object_first_triangle, triangle, side="right")) - 1
        ]

    def triangle_visible(self) -> np.ndarray:
        """(T,) int32, bits of the rays that meet each triangle; (0,) where all meet all."""
        if np.all(self.object_visible == ALL_RAYS | SHADOW_RAY):
            return np.zeros(0, np.int32)
        num_triangles = np.diff(self.object_first_triangle, append=len(self.triangles))
        return np.repeat(self.object_visible, num_triangles)

    def save(self, path: str | os.PathLike) -> None:
        """Write a versioned .npz that `load` reads; it appears whole or not at all."""
        from .scene_file import save_scene

        save_scene(self, Path(path))

    @classmethod
    def load(cls, path: str | os.PathLike) -> Scene:
        """Read what `save` wrote; SceneError if the file is damaged or of a later format."""
        from .scene_file import load_scene

        return load_scene(path)
