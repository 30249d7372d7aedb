"""The Blender extension: its zip, the command in Blender, and good manners beside Cycles."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lighttree_batch.__main__ import main
from lighttree_batch.images import read_render
from lighttree_batch.process import _command

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / ".ci/extension.py"
MANIFEST = "blender_manifest.toml"
WHEELS = (
    "lighttree-0.1.0-py3-none-any.whl",
    "numba-0.68.1-cp313-cp313-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl",
)

WITHOUT = """
import sys
sys.modules[sys.argv[1]] = None  # as if it were not installed
import bpy, lighttree_addon
from lighttree_addon.missing import LightTreePreferences
class Layout:
    def column(self, align): return self
    def label(self, text, icon): print(">", text)
lighttree_addon.register()
lighttree_addon.unregister()
lighttree_addon.register()
assert LightTreePreferences.is_registered and not hasattr(bpy.types.Scene, "lighttree")
LightTreePreferences.draw(type("Preferences", (), {"layout": Layout()}), None)
lighttree_addon.unregister()
"""


def read_toml(path):
    return tomllib.loads(path.read_text())


def build(out, *options):
    """The zips that the build makes of dummy wheels."""
    wheels = out / "wheels"
    wheels.mkdir(parents=True)
    for name in WHEELS:
        (wheels / name).write_bytes(b"a wheel")
    command = [sys.executable, BUILD, "--wheels", wheels, "--out", out, *options]
    subprocess.run(command, check=True, capture_output=True)
    return sorted(out.glob("*.zip"))


def test_manifest_and_package_agree():
    manifest = read_toml(ROOT / "addon" / MANIFEST)
    project = read_toml(ROOT / "pyproject.toml")["project"]
    assert manifest["version"] == project["version"]
    assert manifest["license"] == [f"SPDX:{project['license']}"]
    assert set(manifest["permissions"]) == {"files"}


@pytest.mark.blender
def test_a_zip_holds_the_add_on_its_wheels_and_nothing_else(tmp_path):
    (path,) = build(tmp_path, "--pythons", "3.13", "--platforms", "linux-x64")
    assert path.name == "lighttree-0.1.0-blender5.1-linux-x64.zip"
    with zipfile.ZipFile(path) as file:
        names = set(file.namelist())
        manifest = tomllib.loads(file.read(MANIFEST).decode())
    sources = {path.relative_to(ROOT / "addon").as_posix() for path in ROOT.glob("addon/**/*.py")}
    assert names == sources | {MANIFEST} | {f"wheels/{name}" for name in WHEELS}
    assert manifest["wheels"] == [f"./wheels/{name}" for name in WHEELS]
    assert manifest["platforms"] == ["linux-x64"]
    assert manifest["blender_version_min"] == "5.1.0" and "blender_version_max" not in manifest
    assert manifest["permissions"].keys() == {"files"}


@pytest.mark.blender
def test_each_platform_and_python_gets_a_zip_the_same_every_time(tmp_path):
    options = ("--pythons", "3.11", "3.14", "--platforms", "windows-x64", "macos-arm64")
    first, second = (build(tmp_path / name, *options) for name in "ab")
    assert [path.name.removeprefix("lighttree-0.1.0-") for path in first] == [
        "blender4.5-macos-arm64.zip",
        "blender4.5-windows-x64.zip",
        "python3.14-macos-arm64.zip",
        "python3.14-windows-x64.zip",
    ]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    with zipfile.ZipFile(first[0]) as file:
        manifest = tomllib.loads(file.read(MANIFEST).decode())
    assert (manifest["blender_version_min"], manifest["blender_version_max"]) == ("4.5.0", "5.1.0")


@pytest.mark.blender
@pytest.mark.parametrize("library", ["numba", "embreex", "lighttree_core"])
def test_without_a_library_the_preferences_say_so_and_blender_goes_on(library):
    command = [sys.executable, "-c", WITHOUT, library]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    lines = [line[2:] for line in done.stdout.splitlines() if line.startswith("> ")]
    assert "LightTree cannot start" in lines[0] and library in " ".join(lines)
    assert "install that zip" in lines[-1]


@pytest.mark.blender
def test_every_module_that_can_be_registered_is(registered):
    import lighttree_addon

    files = (ROOT / "addon").glob("*.py")
    named = {path.stem for path in files if "\ndef register():" in path.read_text()}
    modules = {module.__name__.rsplit(".", 1)[1] for module in lighttree_addon.MODULES}
    assert modules == named - {"__init__", "missing"}


@pytest.mark.blender
def test_blender_gets_the_command_and_loses_it(monkeypatch):
    import bpy

    import lighttree_addon

    commands = {}
    monkeypatch.setattr(
        bpy.utils, "register_cli_command", lambda name, run: commands.update({name: run}) or name
    )
    monkeypatch.setattr(bpy.utils, "unregister_cli_command", commands.pop)
    lighttree_addon.register()
    assert commands["lighttree"](["--help"]) == 0
    assert commands["lighttree"](["frobnicate"]) == 2
    lighttree_addon.unregister()
    assert commands == {}


@pytest.fixture
def in_blender(monkeypatch, tmp_path):
    """As if this process were the program Blender, with a file open that is not on disk."""
    app = SimpleNamespace(binary_path="/opt/blender")
    data = SimpleNamespace(filepath=str(tmp_path / "open.blend"))
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(app=app, data=data))
    return data


COMMANDS = [
    ("render", "-o", "x.exr"),
    ("export", "-o", "x.npz"),
    ("compare", "-o", "results"),
    ("probe",),
    ("bench",),
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_in_blender_a_command_takes_the_open_file(command, in_blender, monkeypatch, capsys):
    for argv in ([*command], None):
        monkeypatch.setattr(sys, "argv", ["blender", "-b", "other.blend", "--", *command])
        assert main(argv) == 2
        assert "open.blend: no such file" in capsys.readouterr().err
    assert main([*command, "named.blend"]) == 2
    assert "named.blend: no such file" in capsys.readouterr().err


def test_in_blender_a_file_never_saved_is_missed(in_blender, capsys):
    in_blender.filepath = ""
    for command in COMMANDS[:4]:
        assert main(command) == 2
        assert "Missing argument 'FILE.blend" in capsys.readouterr().err


def test_the_open_file_is_not_for_the_thesis(in_blender, capsys):
    assert main(["compare", "--thesis", "--seconds", "0"]) == 2
    assert "must be 0.001 to" in capsys.readouterr().err


def test_a_child_of_blender_is_blender_without_anybodys_scripts(in_blender):
    command = _command()
    assert command[0] == "/opt/blender"
    assert {"--background", "--factory-startup", "--disable-autoexec"} < set(command)


@pytest.mark.blender
@pytest.mark.parametrize("engines", [("CYCLES", "LIGHTTREE", "CYCLES"), ("LIGHTTREE", "CYCLES")])
def test_cycles_renders_the_same_bits_beside_lighttree(engines, tmp_path):
    images = {}
    for kind, sequence in (("alone", ["CYCLES"]), ("beside", engines)):
        folder = tmp_path / kind
        script = Path(__file__).with_name("beside_cycles.py")
        command = [sys.executable, script, "--", folder, *sequence]
        subprocess.run(command, check=True, capture_output=True)
        images[kind] = [read_render(folder / f"{i}.exr")[0] for i in range(len(sequence))]
    for engine, image in zip(engines, images["beside"], strict=True):
        assert image.any()
        assert np.array_equal(image, images["alone"][0]) == (engine == "CYCLES")
