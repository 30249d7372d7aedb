"""What is installed of LightTree runs, and has all that it reads beside its modules."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1]
LEFT_OUT = {"light_tree.md", "fairness.md", "blender_manifest.toml"}  # nothing reads them
FOLDERS = {"addon": "lighttree_addon", "batch": "lighttree_batch"}
PROJECT = ["pyproject.toml", "README.md", "LICENSE"]


def shipped_files():
    """The files that a wheel is to have, by their names in it."""
    found = {}
    for folder in ("lighttree_core", "addon", "batch"):
        for path in (SOURCE / folder).rglob("*"):
            if path.is_file() and path.suffix != ".pyc" and path.name not in LEFT_OUT:
                name = Path(FOLDERS.get(folder, folder), path.relative_to(SOURCE / folder))
                found[name.as_posix()] = path.read_bytes()
    return found


def copy_sources(target):
    """A checkout without what was built in it before."""
    for name in PROJECT:
        (target / name).parent.mkdir(exist_ok=True)
        (target / name).write_bytes((SOURCE / name).read_bytes())
    names = {installed: source for source, installed in FOLDERS.items()}
    for name, content in shipped_files().items():
        package, _, rest = name.partition("/")
        path = target / names.get(package, package) / rest
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return target


def run(*command, cwd, **variables):
    """What a command prints, errors too."""
    result = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=cwd,
        env=os.environ | {name: str(value) for name, value in variables.items()},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert result.returncode == 0, result.stdout
    return result.stdout


def build(kind, source):
    """(What setuptools made of a folder of sources, what it said)."""
    out = source.parent / f"{kind}-of-{source.name}"
    code = f"from setuptools import build_meta; build_meta.build_{kind}({str(out)!r})"
    said = run("-c", code, cwd=source)
    (made,) = out.iterdir()
    return made, said


def contents(wheel):
    """Of a wheel's files but its metadata, by name."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
        return {name: archive.read(name) for name in names}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    source = tmp_path_factory.mktemp("checkout") / "lighttree"
    source.mkdir()
    made, said = build("wheel", copy_sources(source))
    assert "Warning" not in said, said
    return made


def test_a_wheel_has_every_file_that_is_read(wheel):
    found = contents(wheel)
    assert found == shipped_files()
    for ending in (".npz", "/report.html", "/report.js", "/lighttree-batch.js"):
        assert any(name.endswith(ending) for name in found), ending
    assert sum(name.startswith("lighttree_addon/presets/") for name in found) > 3


def test_a_wheel_built_from_an_sdist_is_the_same(wheel, tmp_path):
    (tmp_path / "lighttree").mkdir()
    sdist, _ = build("sdist", copy_sources(tmp_path / "lighttree"))
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (source,) = (tmp_path / "unpacked").iterdir()
    assert contents(build("wheel", source)[0]) == contents(wheel)


def test_an_installed_wheel_runs(wheel, tmp_path):
    pip = ("-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-index")
    run(*pip, "--target", tmp_path, wheel, cwd=tmp_path)

    def lighttree(*words):
        # It comes before the checkout, which is installed with the tests.
        return run("-m", "lighttree_batch", *words, cwd=tmp_path, PYTHONPATH=tmp_path)

    code = "import lighttree_core, lighttree_batch as b; print(lighttree_core.__file__, b.__file__)"
    for place in run("-c", code, cwd=tmp_path, PYTHONPATH=tmp_path).split():
        assert Path(place).is_relative_to(tmp_path)
    assert "city" in lighttree("demo", "--help")
    assert "city-small" in lighttree("scene", "--list")
    scene = SOURCE / "tests/scenes/city-tiny.npz"
    assert "lights:" in lighttree("render", scene, "--explain")
    assert (tmp_path / "bin").is_dir()
