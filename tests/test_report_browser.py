"""The report in a real Chromium: nothing leaves the page, nothing fails, and all of it works.

Playwright drives the Chromium that the system has; it downloads none.
"""

import re
import shutil
import socket
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread, imsave
from result_folder import SCENE, SPEED, write_probe, write_result_folder

from lighttree_batch import metrics, report

playwright = pytest.importorskip(
    "playwright.sync_api", reason="needs Playwright: pip install 'lighttree[browser]'"
)
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(not CHROMIUM, reason=f"no Chromium here; looked for {NAMES}")
OTHER = "city-alley"
EVIL = "<script>alert(1)-x"


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser") / "results"
    write_result_folder(folder, scenes=(SCENE, OTHER, EVIL), budgets=(1, 4))
    write_probe(folder / SCENE)
    imsave(folder / SCENE / "probe.png", np.ones((20, 40)))
    with pytest.MonkeyPatch.context() as patch:  # FLIP is slow, and not what is tested here
        patch.setattr(metrics, "flip", lambda image, reference: (0.25, image[..., 0]))
        report.write_report(folder)
    return folder


@pytest.fixture
def open_page(browser):
    """Opens a file in a window; at the end nothing may have failed or have been asked for."""
    contexts, troubles = [], []

    def open_page(path, width=1280, hash=""):
        contexts.append(browser.new_context(viewport={"width": width, "height": 900}))
        page = contexts[-1].new_page()
        page.set_default_timeout(10_000)
        page.on("pageerror", lambda error: troubles.append(error))
        page.on("dialog", lambda dialog: note("error", dialog.message))
        page.on("console", lambda message: note(message.type, message.text))
        page.on("request", lambda request: note_request(request.url))
        page.goto(path.as_uri() + hash)
        return page

    def note(kind, text):
        # A software renderer warns of its own slowness; that is no fault of the page.
        if kind == "error" or (kind == "warning" and "GL Driver Message" not in text):
            troubles.append(text)

    def note_request(url):
        if not url.startswith(("file:", "data:", "blob:")):
            troubles.append(url)

    yield open_page
    for context in contexts:
        context.close()
    assert not troubles


def shown(page, selector):
    return [part for part in page.query_selector_all(selector) if part.is_visible()]


def texts(page, selector):
    return [part.inner_text().strip() for part in shown(page, selector)]


def open_viewer(page, number=1):
    viewer = page.locator(f"#viewer-{number}")
    viewer.scroll_into_view_if_needed()
    viewer.get_by_text("lighttree-power").first.wait_for()
    return viewer


def see_middle(viewer):
    """The pixels about the middle of the image that is shown, once it has been drawn."""
    viewer.page.wait_for_timeout(300)
    box = viewer.locator("canvas:visible").first.bounding_box()
    clip = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    picture = viewer.page.screenshot(clip=clip | {"width": 20, "height": 20})
    return imread(BytesIO(picture))[..., :3]


@pytest.mark.parametrize("width", [1280, 390])
def test_no_page_scrolls_sideways(folder, open_page, width):
    page = open_page(folder / "report.html", width)
    for details in page.query_selector_all("summary"):
        details.click()
    assert page.evaluate("document.documentElement.scrollWidth") == width
    # Its text could not be read in a plot as narrow as a telephone: that scrolls by itself.
    assert page.locator(".probe").bounding_box()["width"] >= 640
    assert len(shown(page, ".index tbody tr")) == 3
    assert EVIL in texts(page, "h2")


def test_the_policy_forbids_what_the_page_does_not_do_itself(folder, browser):
    page = browser.new_page()
    page.goto((folder / "report.html").as_uri())
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"http://127.0.0.1:{server.getsockname()[1]}/"
        violations = page.evaluate(
            """address => new Promise(done => {
                const found = [];
                document.addEventListener("securitypolicyviolation", event => {
                    found.push(event.effectiveDirective);
                    if (found.length === 3) done(found);
                });
                document.body.insertAdjacentHTML("beforeend", `<img src="${address}a.png">`);
                const script = document.createElement("script");
                script.textContent = "window.ran = true";
                document.body.append(script);
                fetch(address).catch(() => {});
                setTimeout(() => done(found), 3000);
            })""",
            address,
        )
        assert sorted(violations) == ["connect-src", "img-src", "script-src-elem"]
        assert page.evaluate("window.ran") is None
        server.settimeout(0.3)
        with pytest.raises(TimeoutError):  # nobody knocked
            server.accept()
    page.close()


def test_filters_hide_rows_plots_and_pictures_and_stay_in_the_address(folder, open_page):
    page = open_page(folder / "report.html")
    page.get_by_role("checkbox", name="cycles-no-tree").focus()
    page.keyboard.press("Space")
    page.get_by_label("Scene").first.select_option("city")
    assert len(shown(page, ".scene")) == 1 == len(shown(page, ".index tbody tr"))
    assert texts(page, ".scene h2") == [OTHER]
    for selector in (".pictures figure", ".percentiles tbody tr", ".keys li", ".curve"):
        parts = shown(page, f".scene:not(.off) {selector}")
        methods = {part.get_attribute("data-method") for part in parts} - {None}
        assert methods == set(SPEED) - {"cycles-no-tree"}, selector
    said = page.locator("#filters output").inner_text()
    assert said.startswith("Shown: 1 of 3 scenes, without cycles-no-tree.")
    address = page.url
    assert "stem=city" in address and "without=cycles-no-tree" in address

    again = open_page(folder / "report.html", hash=address.partition("report.html")[2])
    assert texts(again, ".scene h2") == [OTHER]
    assert not again.get_by_role("checkbox", name="cycles-no-tree").is_checked()
    again.get_by_role("link", name=OTHER).first.click()  # going there keeps the filters
    assert "without=cycles-no-tree" in again.url and "at=scene-2" in again.url
    again.get_by_role("button", name="Show all").click()
    playwright.expect(again.locator(".off")).to_have_count(0)
    assert len(shown(again, ".scene")) == 3


def test_a_camera_filter_keeps_its_scenes_alone(folder, open_page):
    page = open_page(folder / "report.html", hash="#camera=street")
    assert texts(page, ".scene h2") == [SCENE]
    nonsense = open_page(folder / "report.html", hash="#camera=nowhere&stem=&without=magic&x")
    assert len(shown(nonsense, ".scene")) == 3


def test_the_wipe_shows_left_of_its_line_the_one_and_right_the_other(folder, open_page):
    page = open_page(folder / "report.html")
    wipe = page.locator("#scene-1 .wipe")
    assert [s.input_value() for s in wipe.locator("select").all()] == ["lighttree", "cycles"]
    wipe.locator("select").last.select_option("cycles-no-tree")

    def picture(name):
        return page.locator(f"#scene-1 [data-picture='{name}'] img").first.get_attribute("src")

    right, left = wipe.locator(".pair img").all()
    assert right.get_attribute("src") == picture("cycles-no-tree")
    assert left.get_attribute("src") == picture("lighttree")
    looks = {}
    for key in ("Home", "End"):
        wipe.get_by_role("slider").focus()
        page.keyboard.press(key)
        looks[key] = take_picture(wipe)
    clip = left.evaluate("image => getComputedStyle(image).clipPath")
    assert re.match(r"inset\(0px calc\(0%\)|inset\(0px\)|inset\(0px 0%", clip), clip
    assert (looks["Home"] != looks["End"]).any()
    wipe.locator("select").last.select_option("lighttree")
    assert (looks["End"] == take_picture(wipe)).all()


def take_picture(wipe):
    """The two images as one sees them, without the rows and columns at their border."""
    wipe.page.evaluate("document.activeElement.blur()")
    wipe.page.wait_for_timeout(200)
    return imread(BytesIO(wipe.locator(".pair").screenshot()))[2:-2, 2:-2]


def test_the_viewer_flips_exposes_and_zooms(folder, open_page):
    page = open_page(folder / "report.html")
    viewer = open_viewer(page)
    canvas = viewer.locator("canvas:visible").first
    canvas.click()
    page.keyboard.press("1")
    reference = see_middle(viewer)
    page.keyboard.press("5")
    assert (see_middle(viewer) != reference).any()
    page.keyboard.press("1")
    assert (see_middle(viewer) == reference).all()
    exposure = viewer.locator("input[type=number]").nth(1)
    before = float(exposure.input_value())
    page.keyboard.press("e")
    assert float(exposure.input_value()) > before
    assert see_middle(viewer).mean() > reference.mean()
    width = canvas.bounding_box()["width"]
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)
    page.wait_for_timeout(300)
    page.keyboard.up("Control")
    assert canvas.bounding_box()["width"] == pytest.approx(1.25 * width, rel=1e-3)


def test_the_viewer_follows_the_filters(folder, open_page):
    page = open_page(folder / "report.html", hash="#without=cycles")
    viewer = open_viewer(page)
    assert "cycles-no-tree" in viewer.inner_text()
    assert not re.search(r"\bcycles(?!-)", viewer.inner_text())
    page.get_by_role("checkbox", name="cycles", exact=True).check()
    viewer.scroll_into_view_if_needed()
    viewer.get_by_text(re.compile(r"cycles$")).first.wait_for()


def test_points_of_a_plot_tell_their_values_to_mouse_and_keys(folder, open_page):
    page = open_page(folder / "report.html")
    plot = page.locator("#scene-1 .plot").first
    plot.locator(".point").nth(3).hover(force=True)
    assert re.match(r"[\w-]+, [\d.]+ s, \d+ samples per pixel: relative MSE", said(plot))
    assert plot.locator(".point[tabindex='0']").count() == 1
    plot.locator(".point[tabindex='0']").focus()
    first = said(plot)
    page.keyboard.press("ArrowRight")
    assert said(plot) != first and said(plot).split(",")[0] == first.split(",")[0]
    page.keyboard.press("ArrowDown")
    assert said(plot).split(",")[0] != first.split(",")[0]
    # With its method filtered out, the plot's tab stop goes to one that is shown.
    name = said(plot).split(",")[0]
    page.locator(f"#filters input[value='{name}']").uncheck()
    stops = plot.locator(".curve:not(.off) .point[tabindex='0']")
    assert stops.count() == 1


def said(plot):
    return plot.locator("output").inner_text()


def test_tab_reaches_all_that_can_be_used(folder, open_page):
    page = open_page(folder / "report.html")
    page.evaluate(
        """() => {
            for (const viewer of document.querySelectorAll(".viewer")) viewer.remove();
            window.reached = new Set();
            addEventListener("focusin", event => reached.add(event.target));
        }"""
    )
    can_be_used = "a[href], select, input, button, summary, .scroll, .point[tabindex='0']"
    for _ in range(len(shown(page, can_be_used)) + 20):
        page.keyboard.press("Tab")
    missed = page.evaluate(
        """selector => [...document.querySelectorAll(selector)].filter(
            part => part.checkVisibility() && !reached.has(part)).map(part => part.outerHTML)""",
        can_be_used,
    )
    assert not missed


def test_paper_gets_numbers_and_pictures_but_no_controls(folder, open_page):
    page = open_page(folder / "report.html", hash="#without=cycles-no-tree")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert not shown(page, ".viewer, .wipe, select, button, input")
    assert len(shown(page, ".pictures img")) and len(shown(page, ".points td"))
    assert "without cycles-no-tree" in page.locator("#filters output").inner_text()
    page.emulate_media(media="screen")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert not shown(page, ".points td")
    assert page.pdf(format="A4").startswith(b"%PDF")


def test_a_split_report_leads_to_its_scenes_and_back_with_the_filters(
    folder, open_page, monkeypatch
):
    monkeypatch.setattr(report, "PAGE_MIB", 0.05)
    monkeypatch.setattr(metrics, "flip", lambda image, reference: (0.25, np.zeros(image.shape[:2])))
    page = open_page(report.write_report(folder), hash="#without=cycles&stem=city")
    assert not shown(page, ".scene") and len(shown(page, ".index tbody tr")) == 1
    page.get_by_role("link", name=OTHER).first.click()
    page.wait_for_url("**/city-alley/report.html*")
    assert texts(page, ".scene h2") == [OTHER]
    assert "cycles" not in {p.get_attribute("data-method") for p in shown(page, "figure")}
    assert open_viewer(page, 2).is_visible()
    page.get_by_role("link", name="All scenes").click()
    page.wait_for_url(re.compile(r"results/report\.html"))
    assert len(shown(page, ".index tbody tr")) == 1
    page.goto((folder / EVIL / "report.html").as_uri())
    assert texts(page, ".scene h2") == [EVIL]
