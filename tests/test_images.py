"""EXR files: ours survive a round trip, Blender's are read in every layout, damaged ones named."""

import numpy as np
import OpenEXR
import pytest

from lighttree_batch.images import ImageError, read_exr, read_render, write_exr

RNG = np.random.default_rng(7)
PIXELS = RNG.standard_normal((5, 7)).astype(np.float32)
RARE = PIXELS[2, 3]
LAYERS = {f"ViewLayer.Combined.{c}": PIXELS + i for i, c in enumerate("RGBA")}
DEPTH = {"ViewLayer.Depth.Z": np.zeros_like(PIXELS)}
ATTRIBUTES = {"cycles.ViewLayer.render_time": "00:01.50", "xDensity": 72.0}


def write_parts(path, *parts):
    """A file as Blender writes it: one dict of channels a part."""
    if len(parts) == 1:
        OpenEXR.File(dict(ATTRIBUTES), parts[0]).write(str(path))
    else:
        names = [name.rpartition(".")[0] for part in parts for name in list(part)[:1]]
        numbered = zip(names, parts, strict=True)
        OpenEXR.File([OpenEXR.Part(dict(ATTRIBUTES), p, n) for n, p in numbered]).write(str(path))
    return path


def test_channels_and_header_survive_a_round_trip(tmp_path):
    extremes = np.array([[0, 1e-38, 3e38, -2.5], [np.inf, -np.inf, 1 / 3, np.pi]], np.float32)
    channels = {"R": extremes, "variance.G": extremes[::-1]}
    header = {"scene": 'Straße </script> "x"', "settings": {"a": [1, 2.5, None, True]}}
    write_exr(tmp_path / "a.exr", channels, header)
    read, read_header = read_exr(tmp_path / "a.exr")
    assert read_header == header
    assert read.keys() == channels.keys()
    for name, pixels in channels.items():
        assert read[name].dtype == np.float32
        np.testing.assert_array_equal(read[name], pixels)


def test_any_view_of_any_float_type_is_written_as_float32(tmp_path):
    image = RNG.random((4, 6, 3))  # float64; its channels are strided views
    write_exr(tmp_path / "a.exr", {"R": image[::-1, ::2, 0]}, {})
    read, _ = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(read["R"], image[::-1, ::2, 0].astype(np.float32))


def test_the_top_row_comes_first_and_is_compressed_losslessly(tmp_path):
    write_exr(tmp_path / "a.exr", {"Y": PIXELS}, {})
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        header = file.header()
        assert header["lineOrder"] == OpenEXR.INCREASING_Y
        assert header["compression"] == OpenEXR.ZIP_COMPRESSION
        np.testing.assert_array_equal(file.channels()["Y"].pixels[0], PIXELS[0])


def test_a_failed_write_keeps_the_old_file_and_leaves_no_other(tmp_path):
    write_exr(tmp_path / "a.exr", {"Y": PIXELS}, {"version": 1})
    with pytest.raises(ImageError, match="one shape"):
        write_exr(tmp_path / "a.exr", {"Y": PIXELS, "Z": PIXELS[1:]}, {})
    with pytest.raises(ImageError, match="height, width"):
        write_exr(tmp_path / "a.exr", {"Y": PIXELS[None]}, {})
    with pytest.raises(TypeError, match="JSON"):
        write_exr(tmp_path / "a.exr", {"Y": PIXELS}, {"bad": {1, 2}})
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
    assert read_exr(tmp_path / "a.exr")[1] == {"version": 1}


def test_an_interrupted_write_leaves_nothing(tmp_path, monkeypatch):
    def write_half(file, path):
        with open(path, "wb") as half:
            half.write(b"v/1")
        raise KeyboardInterrupt

    monkeypatch.setattr(OpenEXR.File, "write", write_half)
    with pytest.raises(KeyboardInterrupt):
        write_exr(tmp_path / "a.exr", {"Y": PIXELS}, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("num_bytes", [0, 3, 200, -40, -1])
def test_a_file_cut_short_is_refused_by_name(tmp_path, num_bytes):
    path = tmp_path / "cut.exr"
    write_exr(path, {"Y": RNG.random((40, 40))}, {})
    path.write_bytes(path.read_bytes()[:num_bytes])
    with pytest.raises(ImageError, match=r"cut\.exr: "):
        read_exr(path)
    with pytest.raises(ImageError, match=r"cut\.exr: "):
        read_render(path)


@pytest.mark.parametrize("what", ["a pixel", "the header"])
def test_a_file_that_is_whole_but_not_what_was_written_is_refused(tmp_path, what):
    path = tmp_path / "flipped.exr"
    write_exr(path, {"Y": PIXELS}, {"seed": 1})
    with OpenEXR.File(str(path), separate_channels=True) as file:
        attributes = {k: v for k, v in file.header().items() if k.startswith("lighttree")}
    if what == "the header":
        attributes["lighttree"] = '{"seed": 2}'
    pixels = np.where(PIXELS == RARE, 0, PIXELS) if what == "a pixel" else PIXELS
    OpenEXR.File(attributes, {"Y": pixels}).write(str(path))
    with pytest.raises(ImageError, match=r"flipped\.exr: damaged, it is not what was written"):
        read_exr(path)


def test_files_that_are_missing_or_not_ours_are_refused_by_name(tmp_path):
    with pytest.raises(ImageError, match=r"none\.exr: no such file"):
        read_exr(tmp_path / "none.exr")
    with pytest.raises(ImageError, match=r"other\.exr: no 'lighttree' header"):
        read_exr(write_parts(tmp_path / "other.exr", {"R": PIXELS}))
    OpenEXR.File({"lighttree": "{"}, {"R": PIXELS}).write(str(tmp_path / "json.exr"))
    with pytest.raises(ImageError, match=r"json\.exr: damaged 'lighttree' header"):
        read_exr(tmp_path / "json.exr")
    with pytest.raises(ImageError, match=r"depth\.exr: no Combined pass, only ViewLayer.Depth.Z"):
        read_render(write_parts(tmp_path / "depth.exr", DEPTH))
    with pytest.raises(ImageError, match=r"red\.exr: channel G and B missing"):
        read_render(write_parts(tmp_path / "red.exr", {"R": PIXELS}))


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param([{c: LAYERS[f"ViewLayer.Combined.{c}"] for c in "RGBA"}], id="plain"),
        pytest.param([LAYERS | DEPTH], id="multilayer in one part"),
        pytest.param([LAYERS, DEPTH], id="one part per pass"),
        pytest.param([DEPTH, LAYERS], id="another pass first"),
    ],
)
def test_the_combined_pass_is_found_in_every_layout_of_blender(tmp_path, parts):
    rgb, attributes = read_render(write_parts(tmp_path / "a.exr", *parts))
    assert rgb.dtype == np.float32
    np.testing.assert_array_equal(rgb, np.stack([PIXELS, PIXELS + 1, PIXELS + 2], axis=-1))
    assert attributes["cycles.ViewLayer.render_time"] == "00:01.50"
    assert "xDensity" not in attributes


def test_half_floats_of_blender_are_read(tmp_path):
    halves = {c: PIXELS.astype(np.float16) for c in "RGB"}
    rgb, _ = read_render(write_parts(tmp_path / "a.exr", halves))
    assert rgb.dtype == np.float32
    np.testing.assert_array_equal(rgb[..., 2], PIXELS.astype(np.float16))
