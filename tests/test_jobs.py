"""Job files: every mistake with its line, what a good one asks for, and 1,000 mangled ones."""

import random
import re
import time

import numpy as np
import pytest
import typer

from lighttree_batch import facts, images
from lighttree_batch.__main__ import app, main
from lighttree_batch.jobs import read_job
from lighttree_batch.methods import InputError
from lighttree_batch.plan import Recipe, plan_scene
from lighttree_batch.toml_lines import find_lines

JOB = """\
out = "results"
methods = ["lighttree", "cycles"]
samples = [1, 4]
seeds = 3
resolution = [64, 36]
bounces = 2
threads = 2
reference_samples = 80
strict = true

[tree]
split = "sah"
thin_box = false
width = 4

[[scene]]
files = ["shots/*.blend", "roof.blend"]
cameras = ["Left", "Right"]
frames = [1, 10]

[[scene]]
generate = "city-small"
lights = 300
seed = 2
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "shots").mkdir()
    for name in ("shots/a.blend", "shots/b.blend", "shots/notes.txt", "roof.blend"):
        (tmp_path / name).touch()
    (tmp_path / "jobs.toml").write_text(JOB)
    return tmp_path


def find_mistakes(folder, text):
    """What is wrong with a job file: {line: sentences}."""
    path = folder / "bad.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as refused:
        read_job(path)
    found = {}
    for line in str(refused.value).splitlines():
        number, sentence = re.fullmatch(rf"{re.escape(str(path))}:(\d+): (.+)", line).groups()
        found[int(number)] = f"{found.get(int(number), '')}{sentence}"
    return found


@pytest.mark.blender  # the names of scenes to generate are there
def test_a_job_file_says_what_to_render(folder):
    job = read_job(folder / "jobs.toml", workers=2)
    options = job.options
    assert job.out == folder / "results"
    assert (options.budget_kind, options.budgets, options.seeds) == ("samples", (1, 4), 3)
    assert (options.methods, options.bounces) == (("lighttree", "cycles"), 2)
    assert (options.resolution, options.threads, options.strict) == ([64, 36], 2, True)
    assert options.chunk_budget == {"samples": 10} and options.workers == 2
    assert options.tree == {"tree_split": "sah", "tree_thin_box": False, "tree_width": 4}
    names = [source.name for source in job.sources]
    shots = [
        f"{f}-{c}-f{n}" for f in ("a", "b", "roof") for c in ("Left", "Right") for n in (1, 10)
    ]
    assert names == [*shots, "city-small-300-seed2"]
    assert job.sources[0].place == (str(folder / "jobs.toml"), 17)
    assert job.sources[-1].file == folder / "results/city-small-300-seed2.blend"
    assert job.sources[-1].recipe == Recipe("city-small", 300, 2)


def test_every_mistake_is_told_at_once_with_its_line(folder):
    text = """\
metods = ["cycles"]
methods = [
    "cyclees",  # ] is not the end
]
samples = [1]
seconds = [1, -2]
seeds = "two"
resolution = [2, 36]
bounces = 1000000000000000000000000000000
strict = 1
out = "shots/a.blend"
reference_seconds = nan

[tree]
split = "best"
buckets = 1
colour = "red"

[[scene]]
files = ["nothing/*.blend", "shots/*.txt", "missing.blend"]
frames = [1, 99_999_999]
lights = 300
[[scene]]
cameras = "Left"

[[scene]]
files = ["roof.blend"]
camera = ["Left"]
"shots" = 1
[[scene]]
files = ["r*.blend"]
"""
    expected = {
        1: r"no key 'metods' here \(did you mean methods\?\); there are out, methods, seconds",
        2: "no method called 'cyclees'; there are lighttree, ",
        5: "seconds and samples exclude each other",
        7: "seeds cannot be 'two'; it must be a whole number",
        8: "width in pixels must be 4 to 65,536, not 2",
        9: "bounces must be 0 to 1,024, not 1000000000",
        10: "strict cannot be 1; it must be true or false",
        11: "a.blend is no folder",
        12: "not nan",
        15: "split must be one of saoh, sah, middle, equal, not 'best'",
        16: "buckets must be 0 for all cuts",
        17: "no key 'colour' here; there are split, thin_box",
        20: "'nothing/.*matches no .blend; .*'shots/.*matches no .*missing.blend: no such file",
        21: "A frame must be -1,048,574 to 1,048,574, not 99999999",
        22: "lights is of scenes to generate",
        23: "either files or generate",
        24: r"cameras cannot be 'Left'; it must be a list like \[",
        28: r"no key 'camera' here \(did you mean cameras\?\)",
        29: "no key 'shots' here; there are files, generate",
        31: "the scene name 'roof' is taken",
    }
    found = find_mistakes(folder, text)
    assert list(found) == list(expected)
    for line, sentence in expected.items():
        assert re.search(sentence, found[line]), found[line]
    assert find_mistakes(folder, text.replace("samples", "#"))[6].startswith("A budget in seconds")


@pytest.mark.parametrize(
    ("text", "line", "sentence"),
    [
        ("a = 1\nb = = 2", 2, "Invalid value in column 5; a job file is TOML"),
        ("a = 1\na = 2", 2, "Cannot overwrite a value"),
        ("seeds = 1\nb = [1,", 2, "a job file is TOML"),
        (b"seeds = 1\nout = '\xff'", 2, "not text"),
        (f"a = {'[' * 5000}", 1, "a job file is TOML"),
        (f"a = 1\nb = {'1' * 5000}", 2, "a job file is TOML"),
        ("", 1, r"no \[\[scene\]\]"),
        ("seeds = 1\n[scene]\nfiles = ['roof.blend']", 2, r"it must be a list like \[\[scene\]\]"),
        ("seeds = 1\nscene = [\n{files = ['roof.blend'], seed = 1}]", 2, "seed is of scenes"),
    ],
)
def test_what_is_no_job_file_is_refused_with_the_line(folder, text, line, sentence):
    found = find_mistakes(folder, text)
    assert list(found) == [line] and re.search(sentence, found[line])


@pytest.mark.blender
def test_scenes_to_generate_are_known_beforehand(folder):
    text = "[[scene]]\ngenerate = 'town'\n[[scene]]\ngenerate = 'city'\nlights = 5\nseed = -1"
    found = find_mistakes(folder, text)
    assert list(found) == [2, 5, 6] and "there are city-small, city" in found[2]
    assert "needs 200 to 10,000,000 lights, not 5" in found[5] and "seed cannot be -1" in found[6]


def test_lines_are_those_of_the_keys():
    text = '''\
# [[scene]] = "not yet"
a.b = """
[[scene]]
c = 1 \\"""
"""  # "
'd "e"' = [ # ]
  "]", [']', {x = 1}], """]""",
]  \t
[ t . "u.v" ]\r
k = '\\'
[[scene]]
[[scene]]
  "f\\u0069les" = ['\\', "\\""]
[scene.s]
k = 1979-05-27T07:32:00Z
[[scene]]
k = "#"
[[scene.n]]
k.l = """"two""""
m = 1'''
    assert find_lines(text) == {
        ("a",): 2,
        ("a", "b"): 2,
        ('d "e"',): 6,
        ("t", "u.v"): 9,
        ("t", "u.v", "k"): 10,
        ("scene", 0): 11,
        ("scene", 1): 12,
        ("scene", 1, "files"): 13,
        ("scene", 1, "s"): 14,
        ("scene", 1, "s", "k"): 15,
        ("scene", 2): 16,
        ("scene", 2, "k"): 17,
        ("scene", 2, "n", 0): 18,
        ("scene", 2, "n", 0, "k"): 19,
        ("scene", 2, "n", 0, "k", "l"): 19,
        ("scene", 2, "n", 0, "m"): 20,
    }


def test_a_dry_run_tells_what_is_left_and_writes_nothing(folder, capsys, monkeypatch):
    text = JOB[: JOB.rindex("[[scene]]")].replace("80", "0").replace("samples", "seconds", 1)
    (folder / "jobs.toml").write_text(text.replace("4]", "4, 600]", 1))
    before = sorted(folder.rglob("*"))
    command = ["batch", str(folder / "jobs.toml"), "--dry-run"]
    assert main(command) == 0
    # 12 scenes of 16 chunks and 2 methods x 3 budgets x 3 seeds; references of 10 x 600 s.
    out = capsys.readouterr().out
    # 2 x 6000 + 6 x (1 + 4 + 600) s; 64 x 36 pixels of 34 x 12 + 60 bytes.
    assert re.search(r"a-Left-f1 .* 34 .* 0 .*over 4 h 20 min.*up to 2 MB", out)
    assert re.search(r"all .* 408 .* 0 .*over 52 h 06 min.*up to 13 MB", out)
    assert "12 scenes are new or changed" in out and "without its set-up" in out
    assert sorted(folder.rglob("*")) == before

    # The first scene was inspected, and two of its images are done in 3 s each.
    monkeypatch.setattr(facts, "are_kernels_compiled", lambda: True)
    job = read_job(folder / "jobs.toml")
    found = {"camera": "Left", "frame": 1, "lights": {}, "triangles": 0, "not_modelled": []}
    found |= {
        "scene": "Scene",
        "view_layer": "ViewLayer",
        "files": [],
        "fixed_files": [],
        "file_sha256": facts.hash_files([job.sources[0].file]),
    }
    found |= {"renderers": facts.describe_renderers(), "versions": facts.describe_packages()}
    scene = job.out / "a-Left-f1"
    scene.mkdir(parents=True)
    pixel = np.ones((1, 1))
    facts.save_facts(found, job.sources[0], scene)
    for unit in plan_scene(job.sources[0], found, job.out, job.options).renders[:2]:
        told = {"samples": 9, "seconds_render": 1.0, "seconds_setup": 2.0}
        images.write_exr(unit.path, dict.fromkeys("RGB", pixel), unit.header | told)
    assert main(command) == 0
    out = capsys.readouterr().out
    assert re.search(r"a-Left-f1 .* 34 .* 2 .*  4 h 22 min", out)
    assert "11 scenes are new or changed" in out
    (folder / "shots/a.blend").write_text("changed")
    assert main(command) == 0
    assert re.search(r"a-Left-f1 .* 34 .* 0 ", capsys.readouterr().out)


VALUES = ("0", "-1", "1e400", "nan", "true", '""', '"\\u0000"', "[]", "[[]]", "{}", "1979-05-27")
VALUES += ('"../*"', '["[!a-"]', "9" * 30, f'["{"x" * 300}"]', '"a\\nb"', "'''\n'''", "{a = 1}")
SNIPPETS = (
    "[",
    "]",
    "[[",
    '"',
    "'",
    '"""',
    "=",
    "#",
    "\n",
    "\\",
    ".",
    "\0",
    "é",
    "{",
    ",",
    "[[scene]]",
)


def mangle(text, chance):
    """A job file after one to four accidents."""
    for _ in range(chance.randint(1, 4)):
        lines = text.splitlines(keepends=True) or ["\n"]
        spot, line = chance.randrange(len(text) + 1), chance.randrange(len(lines))
        before, after, key = lines[:line], lines[line + 1 :], lines[line].partition("=")[0]
        accident = chance.randrange(5)
        if accident == 0:
            text = text[:spot] + chance.choice(SNIPPETS) + text[spot:]
        elif accident == 1:
            text = text[:spot] + text[spot + chance.randint(1, 9) :]
        elif accident == 2:
            text = "".join([*before, *after])
        elif accident == 3:
            text = "".join([*before, chance.choice(JOB.splitlines(keepends=True)), *lines[line:]])
        else:
            text = "".join([*before, f"{key}= {chance.choice(VALUES)}\n", *after])
    return text


@pytest.mark.blender
def test_a_thousand_mangled_job_files_get_a_sentence_or_a_plan(folder, capsys, monkeypatch):
    command, chance = typer.main.get_command(app), random.Random(7)
    monkeypatch.setattr(typer.main, "get_command", lambda app: command)  # or most time goes there
    before, codes = sorted(folder.rglob("*")), []
    path = folder / "jobs.toml"
    for _ in range(1000):
        text = mangle(JOB, chance)
        path.write_bytes(text.encode()[: chance.choice([None] * 20 + [100])])
        started = time.monotonic()
        codes.append(main(["batch", str(path), "--dry-run"]))
        out, err = capsys.readouterr()
        assert time.monotonic() - started < 5, text
        if codes[-1]:
            assert codes[-1] == 2 and not out, (text, err)
            assert all(
                re.match(rf"{re.escape(str(path))}:\d+: \S", line) for line in err.splitlines()
            )
            assert err, text
        else:
            assert "Images" in out and not err, text
    assert 50 < codes.count(0) < 950
    assert sorted(folder.rglob("*")) == before
