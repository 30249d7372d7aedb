"""Materials, and the nodes of worlds and lights -> rows, radiance and factors of a Scene."""

from __future__ import annotations

import bpy
import numpy as np

from lighttree_core.lobes import MAX_LOBES
from lighttree_core.scene import (
    BACK,
    COAT_TINT,
    COLOR,
    COLOR_ATTRIBUTE,
    FRONT,
    IMAGE_TEXTURE,
    NO_TEXTURE,
    SPECULAR_TINT,
    Closures,
    Materials,
    Textures,
)

from .images import ImageTable
from .looks import Look, simplify
from .nodes import NodeReader, Notes
from .shaders import CLEAR, DEFAULT_LOOK, SHADERS, displaced, matt
from .values import Texture, Triple, Value, triple

# Of a Texture, into the columns of `Textures` of the same name.
COPIED_FIELDS = (
    "kind",
    "image_from_uv",
    "extension",
    "interpolation",
    "output",
    "divides_alpha",
)

LIGHT_SAMPLED = {"NONE": (False, False), "FRONT": (True, False), "BACK": (False, True)}
COLOR_COLUMNS = (COLOR, SPECULAR_TINT, COAT_TINT)


class MaterialTable:
    """Gathers materials; each becomes one row of `Materials`, an empty slot another.

    uv_maps, attributes: rows of `Scene.uvs` and `Scene.colors` -> what meshes have to give for
    them. needs: of each material the rows that it needs, of either.
    """

    def __init__(self, notes: Notes):
        self.notes = notes
        self.row_of = {}  # address of a material -> row
        self.looks, self.light_sampled, self.names = [], [], []
        self.images = ImageTable()
        self.uv_maps, self.attributes, self.needs = {}, {}, []

    def row(self, material) -> int:
        """The row of a material, which is read when it is first met."""
        key = material.as_pointer() if material else 0
        if key not in self.row_of:
            self.row_of[key] = len(self.names)
            self.names.append(material.name if material else "(no material)")
            looks = [simplify(look) for look in _read_material(material, self.notes, self.images)]
            self.looks.append(looks)
            self.needs.append(self._needs(looks))
            sides = cycles_setting(material, "emission_sampling", "AUTO")
            self.light_sampled.append(LIGHT_SAMPLED.get(sides, (True, True)))
            if any(sum(part.num_lobes for part in look.parts) > MAX_LOBES for look in looks):
                text = f"of its shaders no more than {MAX_LOBES} lobes are rendered."
                self.notes.add(f"Material {self.names[-1]}", text)
        return self.row_of[key]

    def _needs(self, looks):
        """(rows of `Scene.uvs`, rows of `Scene.colors`) that some looks need."""
        uv_rows, color_rows = set(), set()
        for texture in (value.texture for look in looks for value in _values(look)):
            if texture and texture.kind == COLOR_ATTRIBUTE:
                color_rows.add(self.attributes.setdefault(texture.source, len(self.attributes)))
            elif texture and texture.kind == IMAGE_TEXTURE:
                uv_rows.add(self.uv_maps.setdefault(texture.uv_map, len(self.uv_maps)))
        return uv_rows, color_rows

    def tables(self) -> dict[str, Materials | Closures | Textures]:
        """All rows, by their names in Scene."""
        table = Materials.empty(len(self.names))
        table.names = self.names
        table.light_sampled[:] = np.array(self.light_sampled, bool).reshape(-1, 2)
        closures, textures = _ClosureRows(), _TextureRows(self.uv_maps, self.attributes)
        for row, side in np.ndindex(table.num_closures.shape):
            look = self.looks[row][side]
            table.albedo[row, side] = look.albedo
            factor, texture = _split(look.emission)
            table.emission[row, side] = factor
            table.emission_texture[row, side] = textures.row(texture)
            if not look.is_lambertian:
                table.first_closure[row, side] = closures.first(look.parts)
                table.num_closures[row, side] = len(look.parts)
        return {
            "materials": table,
            "closures": closures.table(textures),
            "textures": textures.table(self.images),
        }


def _values(look: Look):
    """All values of a look."""
    yield look.emission
    for part in look.parts:
        yield from (part.weight, *(value for _, value in part.values))
        yield from (value for value in (part.normal, part.height) if value)


def _split(value: Value) -> tuple[Triple, Value]:
    """A value as a constant times one of a texture, which is within -1 and 1 if that is finite."""
    if value.texture is None:
        return value.bias, Value.of(1.0)
    largest = np.abs([value.at(end) for end in value.texture.ends]).max(axis=0)
    if not any(value.bias):
        largest = np.abs(value.scale)  # so that the texture stays as it is
    factor = np.where(largest > 0, largest, 1.0)
    bias, scale = np.array(value.bias) / factor, np.array(value.scale) / factor
    return triple(factor), Value(triple(bias), triple(scale), value.texture)


class _ClosureRows:
    """Gathers parts; looks that are the same share their rows."""

    def __init__(self):
        self.parts, self.first_of = [], {}

    def first(self, parts) -> int:
        """The first of the rows of some parts."""
        if parts not in self.first_of:
            self.first_of[parts] = len(self.parts)
            self.parts += parts
        return self.first_of[parts]

    def table(self, textures: _TextureRows) -> Closures:
        """All rows."""
        table = Closures.empty(len(self.parts))
        for row, part in enumerate(self.parts):
            table.kind[row] = part.kind
            table.weight[row], weight_texture = _split(part.weight)
            table.weight_texture[row] = textures.row(weight_texture)
            for column, value in part.values:
                num = 3 if column in COLOR_COLUMNS else 1
                table.values[row, column : column + num] = value.mean[:num]
                table.value_texture[row, column] = textures.row(value)
            table.multiscatter[row] = part.multiscatter
            table.normal_texture[row] = textures.row(part.normal or Value.of(0.0))
            table.normal_strength[row] = part.normal_strength
            table.height_texture[row] = textures.row(part.height or Value.of(0.0))
            table.bump_strength[row] = part.bump_strength
        return table


class _TextureRows:
    """Gathers values that vary; equal ones share a row."""

    def __init__(self, uv_maps, attributes):
        self.uv_maps, self.attributes = uv_maps, attributes
        self.row_of = {}

    def row(self, value: Value) -> int:
        """The row of a value, NO_TEXTURE of a constant."""
        if value.texture is None:
            return NO_TEXTURE
        return self.row_of.setdefault(value, len(self.row_of))

    def table(self, images: ImageTable) -> Textures:
        """All rows, and the images."""
        table = Textures.empty(len(self.row_of))
        for value, row in self.row_of.items():
            texture: Texture = value.texture
            for name in COPIED_FIELDS:
                getattr(table, name)[row] = getattr(texture, name)
            if texture.kind == IMAGE_TEXTURE:
                table.source[row] = texture.source
                table.uv_map[row] = self.uv_maps[texture.uv_map]
            elif texture.kind == COLOR_ATTRIBUTE:
                table.source[row] = self.attributes[texture.source]
            if texture.curve:
                table.curve[row] = images.curve_row(texture.curve)
            table.scale[row], table.bias[row] = value.scale, value.bias
        images.fill(table)
        return table


def read_light_factor(light, notes: Notes) -> np.ndarray:
    """(3,) what the nodes of a light multiply its power by."""
    tree = node_tree(light)
    return np.ones(3) if tree is None else _mean_emission(tree, light, notes)


def cycles_setting(data, name: str, default):
    """A property that Cycles gives to a data-block; `default` where its add-on is disabled."""
    return getattr(getattr(data, "cycles", None), name, default)


def _mean_emission(tree, owner, notes):
    """(3,) emission of a world or light, which is the same in all directions."""
    reader = output_reader(tree, owner, notes, FRONT)
    emission = reader.look("Surface").emission if reader else Value.of(0.0)
    if emission.texture:
        reader.note("of its textures only the mean is used.")
    return emission.mean


def _read_material(material, notes, images):
    """Its looks from the front and from the back."""
    if material is None:
        # Cycles' default surface is a Diffuse BSDF up to 4.5 and a Principled BSDF since 5.0.
        return [DEFAULT_LOOK if bpy.app.version >= (5, 0) else matt(0.8)] * 2
    tree = node_tree(material)
    if tree is None:
        return [matt(material.diffuse_color[:3])] * 2
    readers = (output_reader(tree, material, notes, side, images) for side in (FRONT, BACK))
    return [_surface(reader, material) if reader else Look() for reader in readers]


def _surface(reader, material):
    """The look at an output; around a volume alone Cycles' surface lets all light straight through.

    Without either it is black.
    """
    has_surface, has_volume = (reader.source(key)[0].is_output for key in ("Surface", "Volume"))
    if has_volume and not has_surface:
        return CLEAR
    look, (displacement, source) = reader.look("Surface"), reader.source("Displacement")
    if displacement.is_output:
        look = displaced(look, source)
        if material.displacement_method != "BUMP":
            reader.note("its displacement is rendered as bumps.")
    return look


def node_tree(data):
    """The node tree that Cycles renders with, or None.

    Up to 4.5 nodes can be switched off; later the switch does nothing, and asking for it warns.
    """
    return data.node_tree if bpy.app.version >= (5, 0) or data.use_nodes else None


def output_reader(tree, owner, notes: Notes, side: int, images: ImageTable | None = None):
    """A NodeReader of the output of a material, world or light; None if it has none."""
    output = tree.get_output_node("CYCLES")
    if output is None:
        return None
    name = f"{owner.id_type.capitalize()} {owner.name}"
    reader = NodeReader(output, SHADERS, name, notes, side, images or ImageTable())
    if "Volume" in output.inputs and output.inputs["Volume"].is_linked:
        reader.note("the Volume of its nodes is left out.")
    return reader
