"""Read and write OpenEXR images: float32 channels, top row first, with run data in the header.

Our own files keep one JSON string in the attribute `lighttree`, because Blender drops fields
that an engine adds to its own files. Blender's files are read here too, in every layout that
4.5 and 5.x write: plain, multilayer in one part, multilayer with one part per pass.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR

HEADER_KEY = "lighttree"
CHECKSUM = "lighttree_sha256"  # of header and pixels, as OpenEXR itself has no checksums


class ImageError(ValueError):
    """A file that is missing, damaged or not the image it should be."""


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; it takes the place of `path` if the block succeeds."""
    path = Path(path)
    temp = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temp
        os.replace(temp, path)
    finally:
        temp.unlink(missing_ok=True)


def write_exr(path: str | Path, channels: dict[str, np.ndarray], header: dict) -> None:
    """Write (H, W) channels as float32 and a JSON-able header; a failure leaves no file behind."""
    if len(shapes := {np.shape(pixels) for pixels in channels.values()}) != 1:
        raise ImageError(f"{path}: expected channels of one shape, found {sorted(shapes)}.")
    if len(shape := shapes.pop()) != 2 or 0 in shape:
        raise ImageError(f"{path}: expected channels of shape (height, width), found {shape}.")
    pixels = {name: np.ascontiguousarray(array, np.float32) for name, array in channels.items()}
    text = json.dumps(header)
    attributes = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        HEADER_KEY: text,
        CHECKSUM: _hash(text, pixels),
    }
    with replacing(path) as temp:
        OpenEXR.File(attributes, pixels).write(str(temp))


def read_exr(path: str | Path) -> tuple[dict[str, np.ndarray], dict]:
    """Read a file of `write_exr`, whole as it was written: ({name: (H, W) float32}, header)."""
    channels, attributes = _read_parts(path)
    if HEADER_KEY not in attributes:
        raise ImageError(f"{path}: no '{HEADER_KEY}' header; LightTree did not write this file.")
    try:
        header = json.loads(attributes[HEADER_KEY])
    except ValueError as error:
        raise ImageError(f"{path}: damaged '{HEADER_KEY}' header ({error}).") from error
    digest = _hash(attributes[HEADER_KEY], channels)
    if attributes.get(CHECKSUM, digest) != digest:  # files of earlier versions have none
        raise ImageError(f"{path}: damaged, it is not what was written.")
    return channels, header


def _hash(header: str, pixels: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256(header.encode())
    for name in sorted(pixels):
        digest.update(f"{name} {pixels[name].shape} ".encode() + pixels[name].tobytes())
    return digest.hexdigest()


def read_passes(path: str | Path) -> dict[str, np.ndarray]:
    """All channels of a file Blender wrote, (H, W) float32 by name, LAYER.PASS.CHANNEL.

    Those of the first layer's Combined pass are R, G, B and, unless it is 1 throughout, A. Of one
    layer without other passes there is nothing else.
    """
    channels, _ = _read_parts(path)
    first = next(name for name in channels if name.endswith(".Combined.R"))[:-1]
    image = {name: channels[first + name] for name in "RGBA"}
    if np.all(image["A"] == 1):
        del image["A"]
    rest = {name: pixels for name, pixels in channels.items() if not name.startswith(first)}
    return image | rest


def read_render(path: str | Path) -> tuple[np.ndarray, dict[str, str]]:
    """Read the Combined pass of a file Blender wrote: ((H, W, 3) float32, string attributes).

    The first view layer counts when there are several.
    """
    channels, attributes = _read_parts(path)
    combined = (name[:-1] for name in channels if name == "R" or name.endswith(".Combined.R"))
    if (prefix := next(combined, None)) is None:
        raise ImageError(f"{path}: no Combined pass, only {', '.join(sorted(channels))}.")
    if missing := [prefix + c for c in "GB" if prefix + c not in channels]:
        raise ImageError(f"{path}: channel {' and '.join(missing)} missing.")
    return np.stack([channels[prefix + c] for c in "RGB"], axis=-1), attributes


def _read_parts(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """All channels of all parts as float32, and the string attributes of all parts."""
    if not Path(path).is_file():
        raise ImageError(f"{path}: no such file.")
    channels, attributes = {}, {}
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for part in file.parts:
                attributes |= {k: v for k, v in part.header.items() if isinstance(v, str)}
                for name, channel in part.channels.items():
                    channels[name] = np.array(channel.pixels, np.float32)
    except RuntimeError as error:
        raise ImageError(f"{path}: not a readable OpenEXR file ({error}).") from error
    if not channels:  # OpenEXR skips a part whose pixels it cannot decode
        raise ImageError(f"{path}: damaged or cut short, no pixels could be read.")
    return channels, attributes
