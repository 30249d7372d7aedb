"""What image textures and attributes yield, and where in an image a point of a UV map lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mathutils import Euler

from lighttree_core.scene import (
    CLIP,
    CLOSEST,
    COLOR_ATTRIBUTE,
    EXTEND,
    LINEAR,
    MIRROR,
    OPACITY,
    RED,
    REPEAT,
    RGB,
)

from .images import color_space, is_associated, is_data, is_missing, mean_rgba
from .values import Projection, Texture, Value

MISSING_RGB = (1.0, 0.0, 1.0)  # as in Cycles
EXTENSIONS = {"REPEAT": REPEAT, "EXTEND": EXTEND, "CLIP": CLIP, "MIRROR": MIRROR}
INTERPOLATIONS = {"Linear": LINEAR, "Closest": CLOSEST}
KNOWN_SPACES = ("sRGB", "Linear Rec.709", "Non-Color", "Linear", "Raw")
SOURCES = {
    "TILED": "the first of its tiles is rendered everywhere.",
    "SEQUENCE": "one frame of its sequence is rendered.",
    "MOVIE": "one frame of its movie is rendered.",
}


def _image_texture(reader, socket):
    """A texture of the image of an Image Texture node, or a constant."""
    node, image = reader.node, reader.node.image
    output = OPACITY if socket.identifier == "Alpha" else RGB
    if is_missing(image):
        return _missing(reader, socket)
    row = reader.images.row(image)
    read = reader.images[row]
    note_image(reader, image)
    divides_alpha = _divides_alpha(node)
    texture = Texture(
        source=row,
        mean_rgba=read.means[divides_alpha],
        samples=read.samples[divides_alpha],
        low=read.low,
        high=read.high,
        extension=EXTENSIONS[node.extension],
        interpolation=INTERPOLATIONS.get(node.interpolation, LINEAR),
        output=output,
        divides_alpha=divides_alpha,
    )
    uv_map, place = _coordinates(reader)
    if uv_map is None:
        reader.note(f"image {image.name} in {node.name} is replaced by its mean, as {place}.")
        return Value.of(texture.mean)
    if isinstance(uv_map, Projection):
        uv_map = uv_map._replace(matrix=tuple(map(tuple, place[:2].tolist())))
        return varying(replace(texture, uv_map=uv_map))
    image_from_uv = tuple(map(tuple, place[:2, [0, 1, 3]].tolist()))  # of points (u, v, 0)
    return varying(replace(texture, uv_map=uv_map, image_from_uv=image_from_uv))


def _divides_alpha(node):
    """Whether Cycles takes an image's colours without its alpha: if something else uses that."""
    is_used = any(output.identifier == "Alpha" and output.is_linked for output in node.outputs)
    return is_used and is_associated(node.image)


def _missing(reader, socket):
    image = reader.node.image
    if image and image.source in SOURCES:
        what = (
            f"image {image.name} in {reader.node.name}, a {image.source.lower()} that is not read,"
        )
    else:
        path = image.filepath if image else "(none chosen)"
        what = f"missing image file {path} in {reader.node.name}"
    reader.note(f"{what} is rendered as magenta.")
    return Value.of(1.0 if socket.identifier == "Alpha" else MISSING_RGB)


def note_image(reader, image):
    """Note what of an image, and of how the reader's node shows it, is rendered otherwise."""
    node, space = reader.node, color_space(image)
    if image.source in SOURCES:
        reader.note(f"image {image.name}: {SOURCES[image.source]}")
    if not (image.is_float or is_data(image) or space in KNOWN_SPACES):
        reader.note(f"image {image.name} is read as sRGB, not as {space}.")
    if node.interpolation not in INTERPOLATIONS:
        reader.note(f"{node.interpolation} interpolation of {node.name} is rendered as Linear.")


def _coordinates(reader):
    """(a UV map, as in `Texture`, and its matrix) of the place of an image; (None, why not).

    The matrix, 3 x 4, carries a point (u, v, 0), or the place that is projected, to one whose x and
    y are the image's.
    """
    if getattr(reader.node, "projection", "FLAT") != "FLAT":
        return None, f"its projection {reader.node.projection.capitalize()} is not modelled"
    socket, source = reader.source("Vector")
    node = source.node
    if socket.is_output and node.bl_idname == "ShaderNodeMapping" and node.vector_type != "NORMAL":
        uv_map, place = _coordinates(source)
        return uv_map, place if uv_map is None else _mapped(source, place)
    if not socket.is_output and node.bl_idname == "ShaderNodeTexImage":
        return "", np.eye(3, 4)  # unlinked, it lies on the map that the mesh is rendered with
    uv_map = _uv_map(node, socket)
    if uv_map is None:
        return None, f"{socket.name} of {node.name} is not modelled"
    return uv_map, np.eye(3, 4)


def _uv_map(node, socket):
    """The UV map that an output yields, as in `Texture`; None if it is none."""
    kind = node.bl_idname
    if kind == "ShaderNodeTexCoord" and not node.from_instancer:
        maps = {"UV": "", "Generated": Projection("Generated")}
        if not node.object:
            maps["Object"] = Projection("Object")
        return maps.get(socket.identifier)
    if kind == "ShaderNodeUVMap":
        return None if node.from_instancer else node.uv_map
    if kind == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY":
        is_vector = socket.identifier in ("Vector", "Color")
        return (node.attribute_name or None) if is_vector else None
    return None


def _mapped(reader, place):
    """A matrix followed by a Mapping node."""
    location, angles, scale = (reader.color(key) for key in ("Location", "Rotation", "Scale"))
    turn = np.array(Euler(angles).to_matrix())
    kind, place = reader.node.vector_type, place.copy()
    if kind == "TEXTURE":
        place[:, 3] -= location
        inverse = np.divide(1.0, scale, out=np.zeros(3), where=scale != 0)
        return inverse[:, None] * (turn.T @ place)
    place = turn @ (scale[:, None] * place)
    if kind == "POINT":
        place[:, 3] += location
    return place


def varying(texture):
    """What is taken of a texture, as it is."""
    return Value((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), texture)


def _environment_texture(reader, socket):
    """The mean of an environment over all directions."""
    node, image = reader.node, reader.node.image
    if is_missing(image):
        return _missing(reader, socket)
    reader.note(f"image {image.name} in {node.name} is replaced by its mean.")
    read = reader.images[reader.images.row(image)]
    texels = read.texels.reshape(read.height, read.width, 4)
    return Value.of(mean_rgba(texels, read.is_srgb, node.projection == "EQUIRECTANGULAR")[:3])


def _color_attribute(reader, socket):
    """The Color Attribute node; without a name that which the mesh is rendered with."""
    return _attribute_texture(reader.node.layer_name, socket)


def _attribute(reader, socket):
    node = reader.node
    if node.attribute_type != "GEOMETRY" or not node.attribute_name:
        return None
    return _attribute_texture(node.attribute_name, socket)


def _attribute_texture(name, socket):
    """An attribute of the mesh; of the numbers it holds no more is known than that of colours."""
    part = socket.identifier if socket.identifier in ("Fac", "Alpha") else "Color"
    output = RGB if part == "Color" else RED
    return varying(Texture(kind=COLOR_ATTRIBUTE, source=(name, part), output=output))


IMAGE_NODES = {
    "ShaderNodeTexImage": _image_texture,
    "ShaderNodeTexEnvironment": _environment_texture,
    "ShaderNodeVertexColor": _color_attribute,
    "ShaderNodeAttribute": _attribute,
}
