"""Build LightTree as a Blender extension: one zip for each platform and version of Python.

A zip holds the folder addon, a completed manifest, and wheels: LightTree's own, which brings its
command line, and those of its dependencies as the package index has them. A Blender knows one
Python, so each zip has one: both supported ones together would be 220 MB for Linux.
The same wheels and sources give the same zip, byte for byte.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("addon", "batch", "lighttree_core")
MANIFEST = "blender_manifest.toml"
START_OF_TIME = 315532800  # 1980, the earliest that a zip can hold

# What a platform may be called in the name of a wheel.
PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in range(17, 29)],
    "windows-x64": ["win_amd64"],
    "macos-arm64": ["macosx_13_0_arm64"],
}


class Blenders(NamedTuple):
    """The Blenders with one version of Python, from version_min to before version_max.

    has: libraries of theirs that wheels must go with: the oldest numpy, and the OpenEXR to which
    Linux's linker leads calls of the package's own; OpenEXR 3.5 in Blender 4.5 ends in a crash.
    """

    name: str
    version_min: str
    version_max: str | None
    has: tuple[str, ...]


BLENDERS = {
    "3.11": Blenders("blender4.5", "4.5.0", "5.1.0", ("numpy==1.26.*", "OpenEXR==3.3.*")),
    "3.13": Blenders("blender5.1", "5.1.0", None, ("numpy==2.2.*", "OpenEXR==3.4.*")),
}

# Blender has numpy; bpy is Blender. Of SimpleImageIO there are no wheels: LightTree's own wheel
# takes along the one file of it that a report needs.
NOT_WHEELS = ("bpy", "numpy", "simpleimageio")
# Not for the Pythons of all Linux distributions; reports do without FLIP there.
MAY_LACK = ("flip-evaluator",)
# pip asks the machine it runs on, so it overlooks what typer needs on Windows alone.
MORE = {"windows-x64": ["colorama"]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pythons", nargs="+", default=list(BLENDERS), metavar="3.x")
    parser.add_argument("--platforms", nargs="+", default=list(PLATFORMS), choices=PLATFORMS)
    parser.add_argument("--wheels", type=Path, help="a folder of wheels, to download none")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temp:
        own = None if options.wheels else build_own_wheel(Path(temp))
        for python in options.pythons:
            for platform in options.platforms:
                wheels = options.wheels or Path(temp, python, platform)
                if own:
                    download_wheels(python, platform, wheels)
                    shutil.copy(own, wheels)
                path = write_zip(python, platform, sorted(wheels.glob("*.whl")), options.out)
                run(sys.executable, blender_tool(), "validate", path)
                print(f"{path}: {path.stat().st_size / 1e6:.0f} MB")
    return 0


def build_own_wheel(folder: Path) -> Path:
    """The wheel of this checkout, built outside of it so that nothing old slips in."""
    source = folder / "source"
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("LICENSE", "README.md", "pyproject.toml"):
        shutil.copy(ROOT / name, source)
    viewer = distribution("simpleimageio")
    shutil.copy(viewer.locate_file("simpleimageio/flipbook.js"), source / "batch/templates")
    licence = source / "batch/templates/flipbook.LICENSE"
    licence.write_text(viewer.read_text("licenses/LICENSE"), encoding="utf-8")
    run(*PIP, "wheel", "--no-deps", "--wheel-dir", folder, source)
    return next(folder.glob("*.whl"))


def download_wheels(python: str, platform: str, folder: Path) -> None:
    """Fetch the wheels of all dependencies for a version of Python and a platform."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        needs = tomllib.load(file)["project"]["dependencies"]
    needs = [need for need in needs if not need.lower().startswith((*NOT_WHEELS, *MAY_LACK))]
    needs += MORE.get(platform, [])
    needs += BLENDERS[python].has if python in BLENDERS else ()
    command = [*PIP, "download", "--only-binary=:all:", "--dest", folder]
    command += ["--python-version", python]
    for tag in PLATFORMS[platform]:
        command += ["--platform", tag]
    run(*command, *needs)
    for wheel in folder.glob("numpy-*"):
        wheel.unlink()
    for name in MAY_LACK:
        if not run(*command, "--no-deps", name, check=python in BLENDERS):
            print(f"{name} has no wheel for Python {python} on {platform}: left out")


def write_zip(python: str, platform: str, wheels: list[Path], out: Path) -> Path:
    """Write one extension; returns its path."""
    blenders = BLENDERS.get(python, BLENDERS["3.13"])
    contents = {
        path.relative_to(ROOT / "addon").as_posix(): path.read_bytes()
        for path in (ROOT / "addon").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    source = contents[MANIFEST].decode()
    manifest = tomllib.loads(source)
    contents |= {f"wheels/{wheel.name}": wheel.read_bytes() for wheel in wheels}
    added = f'platforms = ["{platform}"]\nwheels = [\n'
    added += "".join(f'    "./wheels/{wheel.name}",\n' for wheel in wheels) + "]\n"
    if blenders.version_max:
        added += f'blender_version_max = "{blenders.version_max}"\n'
    source = source.replace(manifest["blender_version_min"], blenders.version_min)
    contents[MANIFEST] = source.replace("\n[", f"{added}\n[", 1).encode()
    name = blenders.name if python in BLENDERS else f"python{python}"
    path = out / f"lighttree-{manifest['version']}-{name}-{platform}.zip"
    with zipfile.ZipFile(path, "w") as file:
        for member, content in sorted(contents.items()):
            info = zipfile.ZipInfo(member)  # of 1980, whenever it is written
            info.external_attr = 0o644 << 16
            is_packed = member.endswith(".whl")
            info.compress_type = zipfile.ZIP_STORED if is_packed else zipfile.ZIP_DEFLATED
            file.writestr(info, content)
    return path


def blender_tool() -> Path:
    """Blender's own tool for extensions, which the bpy module brings too."""
    (folder,) = importlib.util.find_spec("bpy").submodule_search_locations
    (tool,) = Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    return tool


PIP = (sys.executable, "-m", "pip", "-qq", "--disable-pip-version-check")


def run(*command: str | Path, check: bool = True) -> bool:
    """Whether a command went well; if it must, its failure ends the build."""
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(START_OF_TIME)}
    silent = None if check else subprocess.DEVNULL
    done = subprocess.run(command, env=environment, stderr=silent)
    if check and done.returncode:
        sys.exit(done.returncode)
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
