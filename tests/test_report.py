"""The report is one page that needs nothing but itself, and says plainly what the data say."""

import base64
import hashlib
import html
import json
import re
from html.parser import HTMLParser
from io import BytesIO
from urllib.parse import unquote

import numpy as np
import pytest
from matplotlib.image import imread
from result_folder import (
    SCENE,
    SPEED,
    paint_street,
    write_probe,
    write_references,
    write_result_folder,
)

from lighttree_batch import metrics, plots, report
from lighttree_batch.images import ImageError, read_exr, write_exr

VOID = {"meta", "link", "img", "input"}
STREET = paint_street()


class Page(HTMLParser):
    """Text and attributes of a page; fails where tags are not nested."""

    def __init__(self, path):
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.words, self.attributes, self.scripts, self._open = [], [], [], []
        self.feed(self.source)
        assert not self._open
        self.text = " ".join(" ".join(self.words).replace("\u2019", "'").split())

    def handle_startendtag(self, tag, attrs):  # in SVG; HTML has none
        self.attributes.append((tag, dict(attrs)))

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        into = self.scripts if self._open and self._open[-1] in ("script", "style") else self.words
        into.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.attributes if name == tag]


@pytest.fixture(autouse=True, scope="module")
def fast_flip():
    """FLIP takes a tenth of a second an image, and test_metrics.py looks after it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(metrics, "flip", lambda image, reference: (0.25, image[..., 0]))
        yield


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "results"
    write_result_folder(folder, scenes=(SCENE, "city-alley"))
    return Page(report.write_report(folder))


def make(folder, edit=None, **options):
    """The page of a small result folder, after `edit` changed its run.json."""
    write_result_folder(folder, **{"size": (32, 24), **options})
    run = json.loads((folder / "run.json").read_text())
    if edit:
        edit(run)
        (folder / "run.json").write_text(json.dumps(run))
    return Page(report.write_report(folder))


def test_the_headline_states_the_ratio_that_was_put_in(full):
    found = re.search(
        r"At equal time \(8 s, 2 threads\) LightTree's error is ([\d.]+) times lower than Cycles'",
        full.text,
    )
    # Noise of 5 times the variance; the mean over 2 scenes and 2 seeds of 3072 spiky pixels.
    assert float(found[1]) == pytest.approx(SPEED["lighttree"] / SPEED["cycles"], rel=0.15)
    assert "averaged geometrically over 2 scenes; single seeds say" in full.text
    assert "There is no headline" not in full.text


def test_a_disappointing_number_is_said_as_plainly(tmp_path):
    page = make(tmp_path / "results", speed={"lighttree": 2, "cycles": 4})
    found = re.search(r"LightTree's error is ([\d.]+) times higher than Cycles'", page.text)
    assert float(found[1]) == pytest.approx(2, rel=0.3)


def test_equal_samples_are_not_called_equal_time(tmp_path):
    page = make(tmp_path / "results", speed={"lighttree": 8, "cycles": 4}, kind="samples")
    assert "Calculated for equal time (from 8 samples per pixel, 2 threads)" in page.text
    assert "At equal time (" not in page.text


def test_the_page_loads_nothing_from_anywhere(full):
    assert not full.all("iframe") and not full.all("object")
    for tag, attributes in full.attributes:
        for name in ("src", "href", "srcset", "poster", "data"):
            assert attributes.get(name, "data:").startswith(("data:", "#")), (tag, name)
    style = full.source[full.source.index("<style>") : full.source.index("</style>")]
    assert "url(" not in style and "@import" not in style
    # What looks like an address in the viewer's code is an XML namespace or an error text.
    for address in re.findall(r"https?://[\w./-]+", "".join(full.scripts)):
        assert address.startswith(("http://www.w3.org/", "https://reactjs.org/docs/error-decoder"))


def test_every_picture_decodes_and_has_a_text(full):
    images = full.all("img")
    # Per scene: thumbnail, reference, 3 pictures for each of 4 methods and the tile map.
    assert len(images) == 2 * (1 + 1 + 3 * 4 + 1)
    for image in images:
        assert image["alt"]
        kind, data = image["src"].removeprefix("data:image/").split(";base64,")
        assert imread(BytesIO(base64.b64decode(data)), format=kind).shape[:2] in {(48, 64), (3, 4)}


def test_the_viewer_comes_once_and_holds_the_images_of_each_scene(full):
    assert full.source.count("var flipbook;") == 1
    books = [json.loads(text) for text in full.scripts if text.startswith("{")]
    assert [book["names"] for book in books] == [["reference", *SPEED]] * 2
    data = base64.b64decode(books[0]["dataUrls"][0].split(",")[1])
    rgbe = np.frombuffer(data, np.uint8).reshape(48, 64, 4)
    rgb = np.ldexp(rgbe[..., :3].astype(float), rgbe[..., 3:].astype(int) - 136)
    # One part in 256 of the largest channel, and the reference's own noise of 1 %, 5 sigma.
    assert (abs(rgb - STREET) < 0.06 * STREET.max(axis=2, keepdims=True)).all()
    viewers = [a["id"] for a in full.all("div") if a.get("class") == "viewer"]
    assert viewers == [a["data-viewer"] for a in full.all("script") if "data-viewer" in a]


def test_the_table_is_sorted_by_efficiency_and_cycles_is_the_unit(full):
    table = full.source[full.source.index('<table class="numbers">') :].partition("</table>")[0]
    rows = re.findall(r'<th scope="row">.*?</svg>(\S+)</th>\s*<td>\s*([\d.]+)', table)
    assert [method for method, _ in rows] == sorted(SPEED, key=SPEED.get, reverse=True)
    speed_ups = {method: float(number) for method, number in rows}
    assert speed_ups["cycles"] == 1
    for method, speed in SPEED.items():
        assert speed_ups[method] == pytest.approx(speed / SPEED["cycles"], rel=0.2)


def test_engines_that_agree_are_said_to_agree(full):
    assert "Yes, within the noise of their references." in full.text
    assert "small beside the smallest error" in full.text
    assert "Caution" not in full.text


def test_a_model_difference_is_told_and_never_hidden(tmp_path):
    folder = write_result_folder(tmp_path / "results", size=(64, 48))
    write_references(folder / SCENE, STREET, np.random.default_rng(7), cycles_factor=0.5)
    page = Page(report.write_report(folder))
    assert "Not quite: they differ by more than the noise of their references." in page.text
    ratio = re.search(r"mean brightness is ([\d.]+) ± ([\d.]+) of Cycles", page.text)
    assert float(ratio[1]) == pytest.approx(2, abs=0.02)
    # The combined reference is a quarter off either way: at most (0.25 / 0.75)^2 of error.
    floors = re.search(r"adds ([\d.]+) for LightTree and ([\d.]+) for Cycles", page.text)
    assert 0.05 < float(floors[1]) == float(floors[2]) < 1 / 9
    assert f"Caution: in {SCENE} the reference itself limits what can be told" in page.text


def test_every_number_has_its_definition_and_every_fact_its_place(full):
    terms = "Reference, Relative MSE, trimmed, p50, FLIP, Mean ratio, Efficiency, Render, Peak MiB"
    for term in terms.split(", "):
        assert re.search(rf"<dt>[^<]*{term}", full.source), term
    for fact in ("Example CPU", "15.6 GiB", "blender 5.2.3", "1,000 lights", "41,234 triangles"):
        assert fact in full.text.replace("\xa0", " "), fact
    assert "lighttree compare city-small.blend" in full.text
    assert "max_bounces = 4" in full.text.replace("\xa0", " ")
    assert "IES texture not supported" in full.text


def test_texts_from_the_outside_are_escaped(tmp_path):
    evil = "<script>alert('x')</script> & \"y\""

    def edit(run):
        run["command"] = run["machine"]["cpu"] = evil
        run["scenes"][0] |= {"file": evil, "camera": evil, "failed": [evil], "lights": {evil: 1}}
        run["scenes"].append(dict(run["scenes"][0], name="<script>"))

    page = make(tmp_path / "results", edit, speed={"lighttree": 2})
    assert "alert('x')" not in page.source
    assert evil in page.text
    assert html.escape("<script>") in page.source


def test_an_interrupted_run_shows_what_is_there_and_says_what_is_not(tmp_path):
    folder = write_result_folder(tmp_path / "results", size=(32, 24))
    for path in (folder / SCENE).glob("cycles*-8s-*.exr"):
        path.unlink()
    (folder / SCENE / "reference-cycles.exr").unlink()
    page = Page(report.write_report(folder))
    assert "At equal time (4 s, 2 threads)" in page.text
    assert "4 of 32 renders are missing: cycles-8s-seed1" in page.text
    assert "Not known: reference-cycles.exr: no such file." in page.text


@pytest.mark.parametrize("missing", ["reference.exr", "lighttree-*.exr", "*.exr"])
def test_without_a_comparison_there_is_no_headline_but_a_page(tmp_path, missing):
    folder = write_result_folder(tmp_path / "results", size=(32, 24))
    for path in (folder / SCENE).glob(missing):
        path.unlink()
    page = Page(report.write_report(folder))
    assert "There is no headline" in page.text
    assert "not compared: " in page.text
    assert ("cycles-no-tree-1s-seed1" in page.text) == (missing == "*.exr")


def test_numbers_that_nobody_knows_are_dashes(tmp_path):
    folder = write_result_folder(tmp_path / "results", size=(32, 24), speed={"cycles": 1})
    for path in (folder / SCENE).glob("cycles-*.exr"):
        channels, header = read_exr(path)
        write_exr(path, channels, header | {"samples": 0, "peak_mib": None})
    page = Page(report.write_report(folder))
    row = page.source[page.source.index('<table class="numbers">') :].partition("</table>")[0]
    assert re.search(r"<td>\s*&ndash;</td>\s*</tr>", row)
    assert sum("Relative MSE against" in a.get("aria-label", "") for a in page.all("svg")) == 1


def test_one_seed_is_not_called_a_spread(tmp_path):
    page = make(tmp_path / "results", lambda run: run.update(seeds=1, budgets=[1]))
    assert "only one seed, so the spread is unknown" in page.text
    assert "At equal time (1 s, 2 threads)" in page.text


def test_the_report_only_reads_and_replaces_its_own_files(tmp_path):
    folder = write_result_folder(tmp_path / "results", size=(32, 24), speed={"cycles": 1})
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    told = []
    page = report.write_report(str(folder), lambda *news: told.append(news))
    assert page == folder / "report.html"
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert after.keys() - before.keys() == {
        page,
        folder / "results.csv",
        folder / "results.sqlite",
    }
    assert after.items() >= before.items()
    assert told[0][0] == 0 and told[-1] == (1.0, f"Drawing {SCENE}")
    assert report.write_report(folder).read_bytes() == after[page]
    with pytest.raises(ImageError, match=r"no run\.json"):
        report.write_report(folder / SCENE)


def test_without_flip_the_page_says_so_and_has_all_else(tmp_path, monkeypatch):
    monkeypatch.setattr(metrics, "flip_evaluator", None)
    monkeypatch.setattr(metrics, "flip", lambda image, reference: (np.nan, image[..., 0]))
    folder = tmp_path / "results"
    write_result_folder(folder)
    page = Page(report.write_report(folder))
    assert "FLIP, which needs the package flip-evaluator" in page.text
    assert not any("FLIP map" in image["alt"] for image in page.all("img"))
    assert any("Relative error of each pixel" in image["alt"] for image in page.all("img"))


def test_the_viewer_may_lie_beside_the_templates(tmp_path, monkeypatch):
    script, licence = report.load_viewer()
    assert "MakeFlipBook" in script and "Permission is hereby granted" in licence
    monkeypatch.setattr(report, "TEMPLATES", tmp_path)
    (tmp_path / "flipbook.js").write_text("a viewer")
    (tmp_path / "flipbook.LICENSE").write_text("its licence")
    assert report.load_viewer() == ("a viewer", "its licence")


def test_a_probe_is_shown_where_there_is_one(tmp_path, full):
    assert "Choosing lights alone" not in full.text
    folder = write_result_folder(tmp_path / "results", size=(32, 24))
    (folder / SCENE / "probe.png").write_bytes(b"a picture")
    write_probe(folder / SCENE, "<i>,1,,1.2,,,False,400")
    page = Page(report.write_report(folder))
    assert "at 400 points that the camera sees" in page.text
    assert "lighttree 4 566 0.119 201 503 yes <i> 1 \u2013 1.20 \u2013 \u2013 NO" in page.text
    pictures = [image["src"] for image in page.all("img")]
    assert f"data:image/png;base64,{base64.b64encode(b'a picture').decode()}" in pictures

    write_probe(folder / SCENE, "lighttree,1,much")
    with pytest.raises(ImageError, match=r"probe\.csv: damaged .*; remove it"):
        report.write_report(folder)


def test_the_index_tells_each_scene_apart(full):
    index = full.source[full.source.index('<table class="index">') :].partition("</table>")[0]
    rows = re.findall(r'<tr data-stem="(.*?)" data-camera="(.*?)">', index)
    assert rows == [("city-small", "street"), ("city", "alley")]
    assert index.count("1,000 lights") == 2 == index.count(">yes</a>")
    speed_ups = re.findall(r"<b>\s*([\d.]+)<small>([\d.]+)&ndash;([\d.]+)</small>", index)
    for mean, low, high in speed_ups:
        assert float(low) <= float(mean) <= float(high)
        assert float(mean) == pytest.approx(SPEED["lighttree"] / SPEED["cycles"], rel=0.25)
    assert len(speed_ups) == 2
    anchors = {a["id"] for _, a in full.attributes if "id" in a}
    assert {"scene-1", "scene-2", "models-2"} <= anchors
    assert {a["href"][1:] for a in full.all("a") if a["href"].startswith("#")} <= anchors


def test_where_lighttree_is_worse_is_told_before_the_scenes(tmp_path, full):
    assert "LightTree has the larger error than Cycles in 0 of 8 rows, Cycles in the other 8." in (
        full.text
    )
    assert "LightTree has the larger error nowhere here." in full.text
    speed = {"lighttree": 2, "lighttree-power": 40, "cycles": 10}
    page = make(tmp_path / "results", speed=speed, budgets=(1, 4))
    assert "larger error than Cycles in 2 of 2 rows, Cycles in the other 0." in page.text
    assert "A control is ahead of LightTree in 2 of 2 rows." in page.text
    losses = page.source[page.source.index("worst first</h3>") :].partition("</table>")[0]
    rivals = re.findall(r'data-method="(.*?)"', losses)
    assert rivals == ["lighttree-power"] * 2 + ["cycles"] * 2
    factors = [float(text) for text in re.findall(r"<b>([\d.]+) times higher</b>", losses)]
    assert factors == sorted(factors, reverse=True)
    assert factors[-1] == pytest.approx(5, rel=0.4)
    assert page.source.index("worst first</h3>") < page.source.index('<table class="index">')


def test_one_seed_has_no_interval(tmp_path, full):
    assert re.search(
        r"95\s% confidence interval over seeds: [\d.]+ to [\d.]+ times lower", full.text
    )
    page = make(tmp_path / "results", lambda run: run.update(seeds=1, budgets=[1]))
    assert "No confidence interval: only one seed was rendered" in page.text
    assert "95 % confidence" not in page.text.replace("\xa0", " ").partition("How to read")[0]


def test_every_point_of_a_plot_tells_its_values_and_so_does_the_table(full):
    titles = re.findall(r"<title>(.*?)</title><circle", full.source)
    assert len(titles) == 2 * 2 * len(SPEED) * 4
    for title in titles:
        assert re.fullmatch(
            r"[\w-]+, [\d.]+ s, \d+ samples per pixel: relative MSE [\d.]+ "
            r"\([\d.]+ to [\d.]+ over 2 seeds\)",
            title,
        )
    points = full.source[full.source.index('<table class="numbers points">') :]
    assert points.partition("</table>")[0].count("<tr data-method=") == len(SPEED) * 4
    svg = full.source[full.source.index('<svg viewBox="0 0 480') :].partition("</svg>")[0]
    for axis in ("middle", "end"):  # along x, and along y
        ticks = re.findall(rf'text-anchor="{axis}">([\d.]+)</text>', svg)
        assert 2 <= len(ticks) <= plots.MAX_TICKS
        assert sorted(map(float, ticks)) in ([*map(float, ticks)], [*map(float, ticks[::-1])])


def test_the_policy_lets_only_our_scripts_run(full):
    policy = next(a["content"] for a in full.all("meta") if "http-equiv" in a)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    allowed = set(rules.pop("script-src").split())
    found = {
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in re.findall(r"<script>(.*?)</script>", full.source, re.DOTALL)
    }
    assert found == allowed and len(found) == 3
    for sources in rules.values():
        assert set(sources.split()) <= {"'none'", "'unsafe-inline'", "data:", "blob:"}


def test_a_scene_called_script_stays_a_name(tmp_path, monkeypatch):
    name = "<script>alert(1)-x&y=\"'"
    folder = write_result_folder(
        tmp_path / "results", size=(32, 24), scenes=(name, "b-c"), budgets=(1,)
    )
    page = Page(report.write_report(folder))
    assert name in page.text and "<script>alert" not in page.source
    monkeypatch.setattr(report, "PAGE_MIB", 0.01)
    page = Page(report.write_report(folder))
    assert name in page.text and "<script>alert" not in page.source
    own = Page(folder / name / "report.html")
    assert name in own.text and "<script>alert" not in own.source
    links = [unquote(a["href"]) for a in page.all("a")]
    assert f"{name}/report.html#scene-1" in links


@pytest.mark.parametrize("name", ["../out", "/tmp/out", "..", ".", ""])
def test_a_report_stays_in_its_folder(tmp_path, name):
    with pytest.raises(ImageError, match="no name of a folder"):
        make(tmp_path / "results", lambda run: run["scenes"][0].update(name=name), budgets=(1,))


def test_a_page_that_would_grow_too_large_becomes_one_a_scene(tmp_path, monkeypatch):
    scenes = (SCENE, "city-alley")
    folder = write_result_folder(tmp_path / "results", size=(32, 24), scenes=scenes, budgets=(1,))
    whole = Page(report.write_report(folder))
    monkeypatch.setattr(report, "PAGE_MIB", 0.05)
    index = Page(report.write_report(folder))
    assert len(index.source) < len(whole.source) / 2
    assert len(index.all("img")) == 2 and 'class="viewer"' not in index.source
    assert "var flipbook;" not in index.source
    assert index.text.partition("Scenes")[0] == whole.text.partition("Scenes")[0]
    for number, scene in enumerate(scenes, 1):
        own = Page(folder / scene / "report.html")
        links = [a["href"] for a in index.all("a")]
        assert f"{scene}/report.html#scene-{number}" in links
        assert f"{scene}/report.html#models-{number}" in links
        assert {f"scene-{number}", f"models-{number}"} <= {a.get("id") for _, a in own.attributes}
        assert [a["href"] for a in own.all("a")] == ["../report.html"]
        assert own.source.count('class="viewer"') == 1
        assert 'name="stem"' not in own.source and 'name="method"' in own.source
    monkeypatch.undo()
    report.write_report(folder)
    assert not any((folder / scene / "report.html").exists() for scene in scenes)


def test_what_pictures_weigh_is_foreseen(tmp_path):
    size = (160, 90)
    folder = write_result_folder(tmp_path / "results", size=size, budgets=(1,))
    page = Page(report.write_report(folder))
    data = sum(len(text) for text in re.findall(r"data:[^\"]+", page.source))
    assert data / 2**20 == pytest.approx(report.expected_mib(size, 1 + len(SPEED)), rel=0.4)


def test_a_scene_too_large_for_a_page_says_what_its_viewer_lacks(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "SCENE_MIB", 0.02)
    page = make(tmp_path / "results", budgets=(1,))
    (book,) = [json.loads(text) for text in page.scripts if text.startswith("{")]
    assert (book["width"], book["height"]) == (16, 12)
    assert len(base64.b64decode(book["dataUrls"][0].split(",")[1])) == 16 * 12 * 4
    assert "the viewer has one in 2 of their rows and columns" in page.text
