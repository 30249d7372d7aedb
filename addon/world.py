"""Worlds -> the background's radiance and its image.

What arrives at the output of a world is a constant, or one environment times a constant plus
another; `Environment` holds that as an image, and a constant that the camera sees instead. Of
anything else the mean is taken, and noted.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from mathutils import Euler

from lighttree_core.scene import (
    ALL_BOUNCES,
    ALL_RAYS,
    CAMERA_RAY,
    FRONT,
    Environment,
)
from lighttree_core.texels import linear_rgba

from .image_nodes import note_image, varying
from .images import is_missing
from .lamps import RAY_BITS
from .materials import cycles_setting, node_tree, output_reader
from .nodes import NodeReader, Notes
from .sky.image import MODELS, sky_image
from .values import Texture, Value, triple

ENVIRONMENT_TEXTURE = -1  # a kind of Texture beside those of surfaces; its source: row of `skies`
# What a world's directions are called, as the outputs of nodes.
DIRECTIONS = {
    "ShaderNodeTexCoord": ("Generated", "Object"),
    "ShaderNodeNewGeometry": ("Position",),
}


@dataclass(frozen=True)
class WorldReader(NodeReader):
    """A NodeReader to which an Environment or Sky Texture is a texture: a row of `skies`.

    skies: key -> (image, local_from_world, value), the first two as in `Environment`; value: the
    Value of the image. is_camera: whether the ray that looks is one of the camera.
    """

    skies: dict = field(default_factory=dict)
    is_camera: bool = False

    def _yield(self, socket):
        output = OUTPUTS.get(self.node.bl_idname) if socket.is_output else None
        return output(self, socket) if output else super()._yield(socket)

    def sky(self, key, local_from_world, read) -> Value:
        """What an image yields; read: a function that returns it if it is not in `skies` yet."""
        if key not in self.skies:
            image = read().astype(np.float32)
            image[~np.isfinite(image).all(axis=2)] = 0
            mean = (*image.mean(axis=(0, 1), dtype=np.float64).tolist(), 1.0)
            low, high = min(0.0, float(image.min())), max(0.0, float(image.max()))
            row = len(self.skies)
            texture = Texture(ENVIRONMENT_TEXTURE, row, mean_rgba=mean, low=low, high=high)
            self.skies[key] = image, local_from_world, varying(texture)
        return self.skies[key][2]


def read_world(world, notes: Notes) -> tuple[np.ndarray, Environment]:
    """(3,) radiance of a world, W/(m^2 sr), and the environment that it multiplies."""
    environment = Environment()
    if world is None:
        return np.zeros(3), environment
    visibility = getattr(world, "cycles_visibility", None)
    if visibility:
        rays = RAY_BITS.items()
        environment.visible = ALL_RAYS & sum(bit for ray, bit in rays if getattr(visibility, ray))
    tree = node_tree(world)
    if tree is None:
        return np.array(world.color), environment
    reader = output_reader(tree, world, notes, FRONT)
    if reader is None:
        return np.zeros(3), environment
    reader = WorldReader(**{f.name: getattr(reader, f.name) for f in fields(reader)})
    emission = reader.look("Surface").emission
    if environment.visible & CAMERA_RAY:
        _read_camera_color(environment, reader, emission)
    if emission.texture is None:
        return emission.mean, environment
    if emission.texture.kind != ENVIRONMENT_TEXTURE:
        reader.note("of its textures only the mean is used.")
        return emission.mean, environment
    # Cycles counts the bounces only where it samples the world as a light: never a constant one.
    if cycles_setting(world, "sampling_method", "AUTOMATIC") != "NONE":
        environment.max_bounces = cycles_setting(world, "max_bounces", ALL_BOUNCES)
    image, turn, _ = list(reader.skies.values())[emission.texture.source]
    environment.local_from_world = np.ascontiguousarray(turn, np.float32)
    environment.image = np.float32(emission.texture.take(image))
    if not any(emission.bias):
        return np.array(emission.scale), environment
    environment.image = np.float32(emission.at(environment.image))
    return np.ones(3), environment


def _read_camera_color(environment, reader, emission):
    """The constant that the camera sees where other rays see `emission`, if it differs."""
    seen = replace(reader, is_camera=True, known={}).look("Surface").emission
    if seen == emission:
        return
    if seen.texture:
        reader.note("the camera sees of it what other rays see.")
    else:
        environment.camera_color = np.float32(seen.mean[None])


def _environment_texture(reader, socket):
    """The texture of an Environment Texture node, or the mean of its image."""
    node, image = reader.node, reader.node.image
    turn, fault = _turn(reader)
    if node.projection != "EQUIRECTANGULAR":
        fault = f"its projection {node.projection.replace('_', ' ').capitalize()} is not modelled"
    if is_missing(image) or fault:
        if fault:
            reader.note(f"{node.name} has no direction, as {fault}.")
        return super(WorldReader, reader)._yield(socket)
    note_image(reader, image)
    if node.interpolation == "Closest":
        reader.note(f"Closest interpolation of {node.name} is rendered as Linear.")

    def read():
        texels = reader.images[reader.images.row(image)]
        rgba = linear_rgba(texels.texels, texels.is_srgb)
        return rgba.reshape(texels.height, texels.width, 4)[..., :3]

    return reader.sky((image.as_pointer(), turn.tobytes()), turn, read)


def _sky_texture(reader, socket):
    """The sky of a Sky Texture node; None for a model that is not modelled."""
    turn, fault = _turn(reader)
    if fault:
        reader.note(f"{reader.node.name} has no direction, as {fault}.")
    if fault or reader.node.sky_type not in MODELS:
        return None
    key = reader.node.as_pointer(), turn.tobytes()
    return reader.sky(key, turn, lambda: sky_image(reader.node))


def _turn(reader):
    """((3, 3) from a world's directions to those that a node looks up, None), or (None, a fault).

    Lengths do not matter: whatever turns, mirrors and scales evenly is a turn.
    """
    node = reader.node
    if hasattr(node, "texture_mapping") and not _is_plain(node.texture_mapping):
        return None, f"the Texture Mapping of {node.name} is not modelled"
    socket, source = reader.source("Vector")
    kind = source.node.bl_idname
    if not socket.is_output:
        is_own = source.node == node and kind != "ShaderNodeMapping"
        return (np.eye(3), None) if is_own else (None, f"{source.node.name} is a constant")
    if kind == "ShaderNodeMapping":
        turn, fault = _turn(source)
        return (turn, fault) if turn is None else _mapped(source, turn)
    is_direction = socket.identifier in DIRECTIONS.get(kind, ())
    if not is_direction or getattr(source.node, "object", None):
        return None, f"{socket.name} of {source.node.name} is not modelled"
    return np.eye(3), None


def _is_plain(mapping):
    """Whether a TexMapping leaves coordinates as they are."""
    return (
        (mapping.mapping_x, mapping.mapping_y, mapping.mapping_z) == ("X", "Y", "Z")
        and not any(mapping.translation)
        and not any(mapping.rotation)
        and tuple(mapping.scale) == (1, 1, 1)
    )


def _mapped(reader, turn):
    """A turn followed by a Mapping node, or (None, what of the node is no turn)."""
    kind, name = reader.node.vector_type, reader.node.name
    location, angles, scale = (reader.color(key) for key in ("Location", "Rotation", "Scale"))
    if kind in ("POINT", "TEXTURE") and np.any(location):
        return None, f"the Location of {name} is not modelled"
    if not np.allclose(np.abs(scale), abs(scale[0]), rtol=1e-4) or scale[0] == 0:
        return None, f"the Scale of {name} is not modelled"
    rotation, sign = np.array(Euler(angles).to_matrix()), np.sign(scale)
    if kind == "TEXTURE":
        return sign[:, None] * rotation.T @ turn, None
    return rotation @ (sign[:, None] * turn), None


def _light_path(reader, socket):
    """Whether the camera looks; what it sees lights nothing."""
    if socket.identifier != "Is Camera Ray":
        return None
    return Value(triple(float(reader.is_camera)))


OUTPUTS = {
    "ShaderNodeTexEnvironment": _environment_texture,
    "ShaderNodeTexSky": _sky_texture,
    "ShaderNodeLightPath": _light_path,
}
